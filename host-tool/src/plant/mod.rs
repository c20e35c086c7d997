//! The simulator that stands in for the rig: Prandtl-Ishlinskii and the effects that can be switched on.
