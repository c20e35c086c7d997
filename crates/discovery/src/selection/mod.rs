//! Which effects come in, which leave, and the verdict.

pub mod alike;
pub mod criterion;
pub mod find;
pub mod found;
pub mod jump_evidence;
pub mod jump_naming;
pub mod leaves;
pub mod pairs;
pub mod rounds;
pub mod verdict;
