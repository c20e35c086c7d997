//! How fast a CSV file is read, beside the bare byte records of the csv crate, in one run: `reading_speed FILE`.

use std::path::PathBuf;
use std::time::Instant;

fn main() {
    let path = PathBuf::from(std::env::args().nth(1).expect("a file"));
    let megabytes = std::fs::metadata(&path).expect("a file").len() as f64 / 1e6;
    let mut ratios = Vec::new();
    for _ in 0..3 {
        let begin = Instant::now();
        let mut reader = csv::Reader::from_path(&path).expect("a file");
        let mut record = csv::ByteRecord::new();
        let mut rows = 0_u64;
        while reader.read_byte_record(&mut record).expect("a record") {
            rows += 1;
        }
        let bare_s = begin.elapsed().as_secs_f64();
        let begin = Instant::now();
        let recordings = recording::load(std::slice::from_ref(&path), None).expect("a recording");
        let own_s = begin.elapsed().as_secs_f64();
        assert_eq!(recordings[0].len() as u64, rows);
        ratios.push(bare_s / own_s);
        println!("{rows} rows, {megabytes:.0} MB: bare records {bare_s:.2} s, recording {own_s:.2} s, ratio {:.2}", bare_s / own_s);
    }
    ratios.sort_by(f64::total_cmp);
    println!("median ratio {:.2}", ratios[1]);
}
