"""Where the vehicle is and how it is turned: paths and attitudes with exact derivatives."""
