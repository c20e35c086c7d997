//! The name that everything public in the C files begins with.

/// A name made from a file name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Name {
    stem: String,
    identifier: String,
}

impl Name {
    /// From the file name without its ending; `None` when no `#include` could name the file.
    ///
    /// Whatever is no letter or digit of ASCII becomes an underscore; an identifier cannot begin with a digit, and should not with an
    /// underscore.
    #[must_use]
    pub fn from_stem(stem: &str) -> Option<Self> {
        if stem.is_empty() || stem.chars().any(|letter| letter.is_control() || "\"\\?".contains(letter)) {
            return None;
        }
        let letters: String = stem.chars().map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '_' }).collect();
        let identifier = match letters.trim_matches('_') {
            "" => "model".to_owned(),
            rest if rest.starts_with(|letter: char| letter.is_ascii_digit()) => format!("model_{rest}"),
            rest => rest.to_owned(),
        };
        Some(Self { stem: stem.to_owned(), identifier })
    }

    /// The prefix of functions and types.
    #[must_use]
    pub fn identifier(&self) -> &str {
        &self.identifier
    }

    /// The prefix of macros.
    pub(super) fn upper(&self) -> String {
        self.identifier.to_ascii_uppercase()
    }

    /// The file name of the header.
    pub(super) fn header(&self) -> String {
        format!("{}.h", self.stem)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_name_becomes_an_identifier() {
        for (stem, identifier) in [
            ("model", "model"),
            ("Rig 7-b", "Rig_7_b"),
            ("2x64", "model_2x64"),
            ("_private", "private"),
            ("größe", "gr__e"),
            ("…", "model"),
            ("a.v2", "a_v2"),
        ] {
            assert_eq!(Name::from_stem(stem).unwrap().identifier(), identifier);
        }
    }

    #[test]
    fn a_name_that_no_include_can_hold_is_refused() {
        for stem in ["", "a\"b", "a\\b", "a\nb", "a??/b"] {
            assert_eq!(Name::from_stem(stem), None, "{stem:?}");
        }
    }
}
