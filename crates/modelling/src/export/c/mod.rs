//! A model as C source: one header and one source file that compute what the firmware's estimator computes, to the bit.
//!
//! What may go wrong between two compilers is settled in the text itself. *Constants* are hexadecimal, so none is rounded again.
//! *Products* pass through a volatile, so none is fused with a sum. *Shifts* of negative numbers are written as arithmetic, because C
//! leaves them to the compiler. *Sums* are taken in the order of the firmware, also where an addend is zero: that decides the sign of
//! a zero. Fixed parts stand in `template/` as C, with `@word@` where a model's own numbers go.

mod curve;
mod files;
mod front_end;
mod header;
mod literal;
mod name;
mod network;
mod source;
mod stages;
mod template;

pub use files::CFiles;
pub use name::Name;
pub use source::{CSource, Error, generate};
