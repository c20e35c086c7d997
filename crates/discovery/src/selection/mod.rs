//! Which effects come in, which leave, and the verdict.

pub mod criterion;
pub mod decision;
pub mod find;
pub mod found;
pub mod leaves;
pub mod pairs;
pub mod rounds;
pub mod settings;
pub mod switching_likelihood;
pub mod switching_refits;
pub mod switching_selection;
pub mod verdict;
