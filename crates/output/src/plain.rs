//! Text from files on a terminal: names may hold bytes that a terminal obeys, and these are shown instead of sent.

use std::borrow::Cow;

/// The text with every control character but line ends and tabs, and every mark that turns the direction of writing, in words of its code
/// point, such as `\u{1b}`.
#[must_use]
pub fn plain(text: &str) -> Cow<'_, str> {
    if !text.chars().any(is_obeyed) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for character in text.chars() {
        if is_obeyed(character) {
            shown.extend(character.escape_unicode());
        } else {
            shown.push(character);
        }
    }
    Cow::Owned(shown)
}

/// Whether a terminal does something else with a character than show it.
fn is_obeyed(character: char) -> bool {
    let moves_on = matches!(character, '\n' | '\t');
    (character.is_control() && !moves_on)
        || matches!(character, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_is_told_what_stands_there_and_obeys_nothing_of_it() {
        let hostile = "a\u{1b}]0;owned\u{7}\u{1b}[2Jb\r\u{9b}31m\u{202e}c";
        let shown = plain(hostile);
        assert!(!shown.chars().any(is_obeyed), "{shown:?}");
        assert!(shown.starts_with("a\\u{1b}]0;owned\\u{7}"), "{shown}");
        assert!(matches!(plain("12 µm\tof 3 °C\n"), Cow::Borrowed(_)));
    }
}
