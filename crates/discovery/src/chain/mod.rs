//! The parts that every model is made of: what a form of an effect must say, the columns that it makes, operators and filters.

pub mod columns;
pub mod definition;
pub mod elementary;
pub mod filters;
pub mod form;
pub mod operators;
pub mod side_by_side;
pub mod steps;
pub mod valve;
