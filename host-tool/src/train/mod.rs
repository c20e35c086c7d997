//! Fitting networks to recordings: data preparation, schedules, checkpoints.
