//! Writes the input of a target, a seed and a number to standard output, to look at it.

use std::io::Write;

fn main() {
    let words: Vec<String> = std::env::args().collect();
    let [_, target, seed, _] = &words[..] else { panic!("TARGET SEED NUMBER are wanted") };
    let target = fuzz::targets::all().into_iter().find(|known| known.name == target).expect("a target");
    let number = |text: &String| text.parse().expect("a number");
    let bytes = target.input(&(target.files)(), number(seed), number(&words[3]));
    std::io::stdout().write_all(&bytes).expect("standard output");
}
