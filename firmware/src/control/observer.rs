//! The observer: laser and model blended, so that losing the laser is no jump.
//!
//! The model says how the tip moves, the laser where it is. The observer is the model's estimate plus an **offset** that follows
//! `laser - estimate` with a time constant; fast motion comes from the model, slow truth from the laser. When the laser is lost the
//! offset stays, the blend goes on without a jump, and the **bound** on its error widens from what it was towards the model's own bound.

/// How to blend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverConfig {
    /// Time constant with which the offset follows, s.
    pub time_constant_s: f32,
    /// Bound on the estimate alone, mm.
    pub estimate_bound_mm: f32,
    /// How fast the bound widens without the laser, mm/s.
    pub widening_mm_per_s: f32,
}

/// Offset and bound.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ObserverState {
    offset_mm: f32,
    bound_mm: f32,
    /// Whether the laser was ever seen.
    anchored: bool,
}

/// A blended displacement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blend {
    /// The displacement, mm.
    pub displacement_mm: f32,
    /// Its error should lie within this, mm.
    pub bound_mm: f32,
}

/// Share of the bound that is left a window later while the laser agrees: a second at 50 Hz forgets 63 % of an old disagreement.
const FORGET: f32 = 0.98;

impl ObserverConfig {
    /// One window: the means of laser and estimate over it, as far as there are any.
    ///
    /// # Deadline
    /// No loops.
    pub fn step(&self, state: &mut ObserverState, laser_mm: Option<f32>, estimate_mm: Option<f32>, period_s: f32) -> Option<Blend> {
        match (laser_mm, estimate_mm) {
            (Some(laser_mm), Some(estimate_mm)) => {
                let surprise_mm = laser_mm - estimate_mm - state.offset_mm;
                let share = if state.anchored { period_s / (period_s + self.time_constant_s) } else { 1.0 };
                state.anchored = true;
                state.offset_mm += share * surprise_mm;
                let left_mm = (1.0 - share) * surprise_mm;
                state.bound_mm = (state.bound_mm * FORGET).max(left_mm.abs());
                Some(Blend { displacement_mm: estimate_mm + state.offset_mm, bound_mm: state.bound_mm })
            }
            (None, Some(estimate_mm)) => {
                let widest_mm = self.estimate_bound_mm.max(state.bound_mm);
                let wider_mm = state.bound_mm + self.widening_mm_per_s * period_s;
                state.bound_mm = if state.anchored { wider_mm.min(widest_mm) } else { widest_mm };
                Some(Blend { displacement_mm: estimate_mm + state.offset_mm, bound_mm: state.bound_mm })
            }
            (Some(laser_mm), None) => {
                // Without a model the laser stands alone; the offset must find itself again afterwards.
                state.anchored = false;
                state.offset_mm = 0.0;
                state.bound_mm = 0.0;
                Some(Blend { displacement_mm: laser_mm, bound_mm: 0.0 })
            }
            (None, None) => None,
        }
    }
}
