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

/// A message with its long lines cut in the middle, and of many lines the first: a reader's complaint may quote a line of a megabyte.
#[must_use]
pub fn brief(text: &str) -> Cow<'_, str> {
    const MOST_LINES: usize = 60;
    const LONGEST: usize = 600;
    const KEPT: usize = 250;
    if text.len() <= LONGEST {
        return Cow::Borrowed(text);
    }
    let mut lines: Vec<String> = Vec::new();
    for line in text.lines().take(MOST_LINES) {
        let characters = line.chars().count();
        if characters <= LONGEST {
            lines.push(line.to_owned());
            continue;
        }
        let begin: String = line.chars().take(KEPT).collect();
        let end: String = line.chars().skip(characters - KEPT).collect();
        lines.push(format!("{begin} \u{2026} {end}"));
    }
    if text.lines().nth(MOST_LINES).is_some() {
        lines.push("\u{2026}".to_owned());
    }
    Cow::Owned(lines.join("\n"))
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
    fn a_message_of_a_megabyte_is_cut_and_a_short_one_is_not() {
        assert!(matches!(brief("what is wrong\nand where"), Cow::Borrowed(_)));
        let long = format!("begins{}\u{b5}ends\nnext line\n{}", "x".repeat(1 << 20), "y\n".repeat(1 << 20));
        let short = brief(&long);
        assert!(short.len() < 2000 && short.starts_with("begins") && short.contains("\u{b5}ends\nnext line\ny"), "{}", short.len());
    }

    #[test]
    fn a_terminal_is_told_what_stands_there_and_obeys_nothing_of_it() {
        let hostile = "a\u{1b}]0;owned\u{7}\u{1b}[2Jb\r\u{9b}31m\u{202e}c";
        let shown = plain(hostile);
        assert!(!shown.chars().any(is_obeyed), "{shown:?}");
        assert!(shown.starts_with("a\\u{1b}]0;owned\\u{7}"), "{shown}");
        assert!(matches!(plain("12 µm\tof 3 °C\n"), Cow::Borrowed(_)));
    }
}
