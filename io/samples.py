"""Unpacking of samples: bytes of any format of `StreamFormat` → int8 or int16 arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.jit import kernel
from deepgnss.core.records import Samples
from deepgnss.io.formats import Block, Packing, StreamFormat

Bytes = NDArray[np.uint8]

FLOAT_RMS = 1024.0  # rms of int16 samples made from float32 ones: 60 dB below and 30 dB above it


def level_table(value_bits: int, packing: Packing) -> Samples:
    """Value of each code of a packed format, shape (2**value_bits,).

    All but an explicit table give odd numbers: a quantizer of b bits has 2**b steps that lie
    symmetrically about zero, so no code stands for zero and the table adds no offset.
    sign_magnitude: highest bit the sign (1: negative), rest m: ±(2m + 1). twos_complement: 2c + 1.
    offset_binary: 2c − (2**b − 1).
    """
    code = np.arange(1 << value_bits)
    half = 1 << (value_bits - 1)
    levels: NDArray[np.int64]
    match packing.code:
        case "sign_magnitude":
            levels = np.where(code < half, 1, -1) * (2 * (code % half) + 1)
        case "twos_complement":
            levels = 2 * np.where(code < half, code, code - 2 * half) + 1
        case "offset_binary":
            levels = 2 * code - (2 * half - 1)
        case "levels":
            levels = np.array(packing.levels)
    if levels.min() >= -128 and levels.max() <= 127:
        return levels.astype(np.int8)
    return levels.astype(np.int16)


def full_scale(stream: StreamFormat) -> int:
    """Largest magnitude the unpacked samples of a format can have."""
    if stream.is_packed:
        return int(np.abs(level_table(stream.value_bits, stream.packing).astype(np.int64)).max())
    return 128 if stream.format == "int8" else 32768


def byte_table(value_bits: int, packing: Packing) -> Samples:
    """Values of each byte in their order in time, shape (256, 8 // value_bits)."""
    byte = np.arange(256)[:, np.newaxis]
    shift = np.arange(0, 8, value_bits)
    if packing.order == "msb_first":
        shift = shift[::-1]
    table: Samples = level_table(value_bits, packing)[(byte >> shift) & ((1 << value_bits) - 1)]
    return table


@kernel
def unpack_fields(
    words: Bytes,
    word_bytes: int,
    shift: int,
    step: int,
    value_bits: int,
    levels: Samples,
    values: Samples,
) -> None:
    """Take the values out of a bit field of little-endian words.

    Parameters
    ----------
    words: shape (n · word_bytes,).
    shift: bits below the first value of a word; step: from one value to the next, bits (negative:
        msb first).
    levels: value of each code. values: result, shape (n · values per word,).
    """
    mask = (1 << value_bits) - 1
    word_count = words.size // word_bytes
    per_word = values.size // max(word_count, 1)
    for w in range(word_count):
        word = np.uint64(0)
        for b in range(word_bytes):
            word |= np.uint64(words[w * word_bytes + b]) << np.uint64(8 * b)
        for k in range(per_word):
            code = (word >> np.uint64(shift + k * step)) & np.uint64(mask)
            values[w * per_word + k] = levels[np.int64(code)]


@kernel
def scale_floats(values: NDArray[np.float32], factor: float, scaled: NDArray[np.int16]) -> None:
    """Round `factor` · values to int16 (ties to even), saturated; NaN becomes 0. Shapes (n,)."""
    for k in range(values.size):
        x = np.rint(np.float64(values[k]) * factor)
        if x >= 32767.0:
            scaled[k] = 32767
        elif x <= -32767.0:
            scaled[k] = -32767
        elif x == x:
            scaled[k] = np.int16(x)
        else:
            scaled[k] = 0


@kernel
def pick_channel(
    frames: Samples,
    components: int,
    index: int,
    swap: bool,
    negate: bool,
    lowest: int,
    out: Samples,
) -> None:
    """Copy one channel out of interleaved ones, I first, Q negated on demand.

    Parameters
    ----------
    frames: shape (n, channels · components). index: the channel wanted.
    swap: Q comes first. negate: undo an inverted spectrum, z → z*. lowest: smallest number of the
        type, whose negative is its neighbour's.
    out: result, shape (n, components).
    """
    first = index * components
    if components == 1:
        for k in range(frames.shape[0]):
            out[k, 0] = frames[k, first]
        return
    i_column = first + 1 if swap else first
    q_column = first if swap else first + 1
    for k in range(frames.shape[0]):
        out[k, 0] = frames[k, i_column]
        q = frames[k, q_column]
        if negate:
            q = -(q + 1) if q == lowest else -q
        out[k, 1] = q


def unpack_values(data: Bytes, stream: StreamFormat, float_factor: float) -> Samples:
    """All real numbers of whole words, in the order of time, shape (n,); a view where possible.

    Parameters
    ----------
    data: whole words of the stream, headers removed.
    float_factor: float32 only: what to multiply by before rounding to int16.
    """
    match stream.format:
        case "int8":
            return data.view(np.int8)
        case "int16":
            return np.require(data.view("<i2"), np.int16, "A")
        case "float32":
            values = np.require(data.view("<f4"), np.float32, "A")
            scaled = np.empty(values.size, np.int16)
            scale_floats(values, float_factor, scaled)
            return scaled
    packing, bits = stream.packing, stream.value_bits
    shift, width = stream.word_field
    if (shift, width) == (0, 8 * packing.word_bytes):
        if packing.order == "msb_first" and packing.word_bytes > 1:
            data = data.reshape(-1, packing.word_bytes)[:, ::-1].ravel()
        return byte_table(bits, packing).take(data, axis=0).reshape(-1)
    levels = level_table(bits, packing)
    fields = np.empty(data.size // packing.word_bytes * stream.values_per_word, levels.dtype)
    msb_first = packing.order == "msb_first"
    unpack_fields(
        data,
        packing.word_bytes,
        shift + width - bits if msb_first else shift,
        -bits if msb_first else bits,
        bits,
        levels,
        fields,
    )
    return fields


def arrange(values: Samples, stream: StreamFormat) -> Samples:
    """Samples of one channel from whole frames of values: shape (n,) real or (n, 2) as I, Q.

    A view of `values` when nothing has to be moved, else a new array; contiguous either way.
    """
    negate = stream.spectrum == "inverted" and stream.samples == "iq"
    swap = stream.iq_order == "qi" and stream.samples == "iq"
    frames = values.reshape(-1, stream.values_per_frame)
    if stream.channels.count > 1 or swap or negate:
        out = np.empty((frames.shape[0], stream.components), values.dtype)
        lowest = int(np.iinfo(values.dtype).min)
        pick_channel(frames, stream.components, stream.channels.index, swap, negate, lowest, out)
        frames = out
    return frames if stream.samples == "iq" else frames.reshape(-1)


def samples_by_byte(stream: StreamFormat) -> Samples | None:
    """The samples of every byte, shape (256, per byte) real or (256, per byte, 2) as I, Q.

    None where a byte does not hold samples whole, in the order of time, by itself.
    """
    packing = stream.packing
    if packing.order == "lsb_first" and stream.word_field == (0, 8 * packing.word_bytes):
        packing = replace(packing, word_bytes=1, field=None)  # words that are bytes in a row
    if not stream.is_packed or packing.word_bytes > 1:
        return None
    alone = replace(stream, packing=packing, block=Block())
    if alone.values_per_word % alone.values_per_frame:
        return None
    samples = arrange(unpack_values(np.arange(256, dtype=np.uint8), alone, 1.0), alone)
    table: Samples = samples.reshape(256, -1, *samples.shape[1:])
    return table
