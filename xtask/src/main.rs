//! The project's chores: `cargo xtask test | ci | bench`.
fn main() {}
