//! Data without a rig: [`excitation`] makes pressures over time, [`plant`] turns them into recordings.

pub mod excitation;
pub mod plant;
