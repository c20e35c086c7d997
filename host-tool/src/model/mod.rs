//! What every model has in common: load it, run it freely from the start.
