//! Physics models from recordings.
