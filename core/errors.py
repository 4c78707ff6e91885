"""The errors deepgnss raises. Lost lock is data, not an exception."""


class DeepGnssError(Exception):
    """Base of everything raised on purpose; its text is one line for the user."""


class ConfigError(DeepGnssError):
    """A configuration that cannot be used: names the key, the value and what would fit."""


class RecordingError(DeepGnssError):
    """A recording that is missing, empty, truncated, or not what its description says."""


class InputFileError(DeepGnssError):
    """An aiding file (NAV, truth, log) that cannot be read or does not fit the recording."""


class OutputError(DeepGnssError):
    """An output file or folder that cannot be written."""


class NumericalError(DeepGnssError):
    """A computation that lost its footing (NaN, a covariance that is not positive)."""
