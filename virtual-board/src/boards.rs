//! The boards there are models of. Their constants are the firmware's own files, so a pin is written in one place.

/// What a board around the STM32F405 has to say.
#[path = "."]
pub mod stm32f405 {
    #[path = "../../firmware/src/board/stm32f405/wiring.rs"]
    pub mod wiring;
}
#[path = "../../firmware/src/board/custom_f405/mod.rs"]
pub mod custom_f405;
#[path = "../../firmware/src/board/feather_f405/mod.rs"]
pub mod feather_f405;

use stm32f405::wiring::Wiring;

/// A board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Around an STM32F405.
    Stm32f405(Wiring),
}

/// All boards; the first is meant unless another is asked for.
pub const BOARDS: [Kind; 2] = [Kind::Stm32f405(custom_f405::WIRING), Kind::Stm32f405(feather_f405::WIRING)];

impl Kind {
    /// Its name.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Stm32f405(wiring) => wiring.name,
        }
    }

    /// The board of this name.
    ///
    /// # Errors
    /// When there is none, with the names there are.
    pub fn named(name: &str) -> Result<Self, String> {
        let names = || BOARDS.iter().map(Self::name).collect::<Vec<_>>().join(", ");
        BOARDS.into_iter().find(|board| board.name() == name).ok_or_else(|| format!("`{name}` is no board; there are {}", names()))
    }
}
