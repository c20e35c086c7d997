//! What the image does with a work file.

use cortex_m_semihosting::hprintln;
use firmware::estimator::{Estimator, EstimatorState, Kernel, KernelSource, Network, Portable};
use firmware::parity::{Excitation, RandomNetwork, estimator_digest, network_digest, shapes};
use model_export::blob;

use crate::machine::Counter;
use crate::tick::count_ticks;

/// A work file, read.
pub struct Work {
    task: u32,
    steps: usize,
    seed: u32,
    blobs: Blobs,
}

/// The blobs that are left.
struct Blobs {
    count: u32,
    rest: &'static [u8],
}

impl Iterator for Blobs {
    type Item = &'static [u8];

    fn next(&mut self) -> Option<&'static [u8]> {
        self.count = self.count.checked_sub(1)?;
        let (length, rest) = self.rest.split_first_chunk()?;
        let length = u32::from_le_bytes(*length) as usize;
        let (blob, rest) = (rest.get(..length)?, rest.get(length.next_multiple_of(4)..)?);
        self.rest = rest;
        Some(blob)
    }
}

impl Work {
    /// Reads the header.
    pub fn read(bytes: &'static [u8]) -> Option<Self> {
        let (words, _) = bytes.as_chunks::<4>();
        let word = |index: usize| words.get(index).map(|word| u32::from_le_bytes(*word));
        let blobs = Blobs { count: word(4)?, rest: bytes.get(20..)? };
        Some(Self { task: word(1)?, steps: word(2)? as usize, seed: word(3)?, blobs })
    }

    /// Does the task, with memory for packed weights and for random networks.
    pub fn run(self, memory: &mut [u32], random: &mut RandomNetwork) {
        // What lies there before must not matter.
        memory.fill(u32::MAX);
        match self.task {
            1 => self.sweep(memory, random),
            2 => self.golden(memory),
            3 => self.cost(memory),
            4 => self.tick(memory),
            task => hprintln!("error: no task {}", task),
        }
        hprintln!("done");
    }

    /// Random networks of every shape: the packed kernel's digest of each, and whether the portable kernel gives the same here.
    fn sweep(&self, memory: &mut [u32], random: &mut RandomNetwork) {
        random.fill_pool(self.seed);
        for (seed, (inputs, layers)) in (0..).zip(shapes()) {
            random.draw(seed, inputs, &layers);
            let Ok(network) = Network::new(&random.wire(), inputs) else {
                hprintln!("error: network {} is not valid", seed);
                continue;
            };
            let Ok(packed) = memory.kernel(&network) else {
                hprintln!("error: network {} does not fit", seed);
                continue;
            };
            let digest = network_digest(&network, &packed, seed, self.steps);
            if digest != network_digest(&network, &Portable, seed, self.steps) {
                hprintln!("error: network {} with {} inputs and the layers {:?} differs between the kernels", seed, inputs, layers);
            }
            hprintln!("{} {:08x}", seed, digest);
        }
    }

    /// Each blob's golden vectors, then random steps.
    fn golden(self, memory: &mut [u32]) {
        let (seed, steps) = (self.seed, self.steps);
        for bytes in self.blobs {
            let Ok(blob) = blob::decode(bytes) else {
                hprintln!("error: a blob does not decode");
                continue;
            };
            let model = &blob.model;
            let range = [model.input.minimum, model.input.maximum];
            let (Ok(packed), Ok(portable)) = (Estimator::with_kernel(model, &mut *memory), Estimator::new(model)) else {
                hprintln!("error: a blob is refused");
                continue;
            };
            let replay = packed.replay(&model.golden);
            // The portable kernel takes three times as long: a tenth of the steps shows the same.
            let alike = estimator_digest(&packed, range, seed, steps / 10) == estimator_digest(&portable, range, seed, steps / 10);
            if !alike {
                hprintln!("error: the kernels differ");
            }
            let digest = estimator_digest(&packed, range, seed, steps);
            hprintln!("{} {} {:08x}", replay.samples, replay.passed(), digest);
        }
    }

    /// Each blob in the tick.
    fn tick(self, memory: &mut [u32]) {
        let counter = checked_counter();
        for bytes in self.blobs {
            count_ticks(&counter, bytes, memory, self.seed, self.steps);
        }
    }

    /// Each blob's instructions per step, least and most, with the packed kernel, then with the portable one.
    fn cost(self, memory: &mut [u32]) {
        let counter = checked_counter();
        for bytes in self.blobs {
            let Ok(blob) = blob::decode(bytes) else {
                hprintln!("error: a blob does not decode");
                continue;
            };
            let range = [blob.model.input.minimum, blob.model.input.maximum];
            let (Ok(packed), Ok(portable)) = (Estimator::with_kernel(&blob.model, &mut *memory), Estimator::new(&blob.model)) else {
                hprintln!("error: a blob is refused");
                continue;
            };
            let [packed_least, packed_most] = count_steps(&counter, &packed, range, self.seed, self.steps);
            let [portable_least, portable_most] = count_steps(&counter, &portable, range, self.seed, self.steps.min(20));
            hprintln!("{} {} {} {}", packed_least, packed_most, portable_least, portable_most);
        }
    }
}

/// Two loops of different lengths must differ by their instructions.
fn checked_counter() -> Counter {
    let counter = Counter::start();
    if counter.count_loop(123_456).wrapping_sub(counter.count_loop(1000)) != 2 * (123_456 - 1000) {
        hprintln!("error: the counter does not count instructions; is -icount shift=0 missing?");
    }
    counter
}

fn count_steps<K: Kernel>(counter: &Counter, estimator: &Estimator<'_, K>, range: [f32; 2], seed: u32, steps: usize) -> [u32; 2] {
    let mut excitation = Excitation::new(range[0], range[1], seed);
    let mut state = EstimatorState::default();
    let (mut least, mut most) = (u32::MAX, 0);
    for _ in 0..steps {
        let sample = excitation.sample();
        let (count, _) =
            counter.count(|| core::hint::black_box(estimator.step(core::hint::black_box(&mut state), core::hint::black_box(sample))));
        least = least.min(count);
        most = most.max(count);
    }
    [least, most]
}
