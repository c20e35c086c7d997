//! The child process: reads changed files and says the number of each before it begins. A crash or a hang ends it, and the parent knows at
//! which number.

use std::io::Write;

use fuzz::readers::Wrong;
use fuzz::targets;

fn main() {
    let words: Vec<String> = std::env::args().collect();
    let [_, target, seed, first, count] = &words[..] else { panic!("TARGET SEED FIRST COUNT are wanted") };
    let number = |text: &String| text.parse::<u64>().expect("a number");
    let (seed, first, count) = (number(seed), number(first), number(count));
    let target = targets::all().into_iter().find(|known| known.name == target).expect("a target");
    #[cfg(unix)]
    {
        // Beside what the program itself takes.
        let own = 256 << 20;
        rlimit::setrlimit(rlimit::Resource::AS, fuzz::MEMORY_BYTES + own, fuzz::MEMORY_BYTES + own).expect("a limit");
    }
    let files = (target.files)();
    let mut out = std::io::stdout().lock();
    // What is made before the first input is no reader's time.
    writeln!(out, "ready").and_then(|()| out.flush()).expect("a parent that listens");
    let mut accepted = 0;
    for number in first..first + count {
        let bytes = target.input(&files, seed, number);
        writeln!(out, "{number}").and_then(|()| out.flush()).expect("a parent that listens");
        match (target.read)(&bytes) {
            Ok(()) => accepted += 1,
            Err(Wrong::Refused(message)) => assert!(!message.is_empty(), "a refusal without a reason"),
            Err(Wrong::Garbage(problem)) => panic!("garbage was accepted: {problem}"),
        }
    }
    writeln!(out, "accepted {accepted}").expect("a parent that listens");
}
