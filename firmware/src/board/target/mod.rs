//! What every board's image needs of processor and linker, whatever the chip; target only.

pub mod crash;
pub mod cycles;
pub mod identity;
pub mod memory;
pub mod models;
pub mod protection;
