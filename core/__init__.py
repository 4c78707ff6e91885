"""Ground floor: constants, time, records that cross walls, errors, kernel decorator."""
