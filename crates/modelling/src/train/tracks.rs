//! Recordings as the network sees them: features, what the front end leaves over, and who walks where.
//!
//! A *track* is one gap-free stretch of a recording after the front end. A *visit* is a lane's walk over a piece of a track; the
//! network state is zero at its start. Which visit a lane makes depends only on the seed, the lane and the visit's number, so a resumed
//! run goes on with the same visits.

use firmware::estimator::FrontEndState;
use model_export::schema;
use model_export::validate::Invalid;
use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::batch::Batch;
use super::config::TrainConfig;
use super::front_end::Channels;
use crate::network::{built, limit_feature, narrowed, window_sample};
use recording::Recording;

/// One gap-free stretch, normalised.
#[derive(Clone, Debug)]
pub struct Track {
    /// `[sample][feature]`, as the network gets them.
    pub features: Vec<f32>,
    /// Front end's readout in normalised output.
    pub front_end: Vec<f32>,
    /// Measured output, normalised.
    pub output: Vec<f32>,
    /// How far off in normalised output a sample says nothing, because the stick band held the output; 0 elsewhere.
    pub slack: Vec<f32>,
    /// Which samples training may learn from; the others are for validation.
    pub training: Vec<bool>,
}

impl Track {
    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.output.len()
    }

    /// Whether there is no sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.output.is_empty()
    }
}

/// Runs a front end over recordings; each gap starts it afresh, as evaluation does. `parts` says which samples are for training.
///
/// # Errors
/// When the front end is out of its domain.
pub fn tracks(
    recordings: &[Recording],
    parts: &[Vec<bool>],
    front_end: &schema::FrontEnd,
    channels: &Channels,
) -> Result<Vec<Track>, Invalid> {
    let built = built(front_end, &channels.input, &channels.more_inputs)?;
    let output = &channels.output;
    let width = built.features();
    let mut tracks = Vec::new();
    for (recording, part) in recordings.iter().zip(parts) {
        let inputs = recording.inputs();
        for segment in recording.segments() {
            let mut state = FrontEndState::default();
            let mut track =
                Track { features: Vec::new(), front_end: Vec::new(), output: Vec::new(), training: Vec::new(), slack: Vec::new() };
            let mut features = vec![0.0; width];
            track.training.extend_from_slice(&part[segment.clone()]);
            for index in segment {
                #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
                let measured = recording.output[index] as f32;
                let step = built.step(&mut state, &narrowed(&inputs, index), &mut features);
                track.features.extend(features.iter().map(|&value| limit_feature(value)));
                let normalised = (measured - output.offset) / output.scale;
                let band = front_end.stick_band;
                let rests = track.output.last().is_some_and(|last| (normalised - last).abs() < STICK_TOLERANCE * band);
                track.slack.push(if rests { band } else { 0.0 });
                track.front_end.push(step.readout);
                track.output.push(normalised);
            }
            tracks.push(track);
        }
    }
    Ok(tracks)
}

/// An output that moves by less than this share of the stick band in a sample rests.
pub const STICK_TOLERANCE: f32 = 0.05;

/// What is left of an error where the output may be off by `slack`.
#[must_use]
pub fn beyond(error: f64, slack: f64) -> f64 {
    error - error.clamp(-slack, slack)
}

/// Seeds of separate purposes: equal numbers in different purposes do not give equal choices.
#[derive(Clone, Copy)]
pub enum Purpose {
    /// Starting weights.
    Weights = 1,
    /// Which recordings validate.
    Split = 2,
    /// Order of the recordings in an epoch.
    Order = 3,
    /// Where a visit starts.
    Visit = 4,
    /// Synthetic recordings.
    Synthetic = 5,
}

/// A random stream of its own for one purpose and number.
#[must_use]
pub fn stream(seed: u64, purpose: Purpose, number: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(((purpose as u64) << 56) | number);
    random
}

/// A piece of a track that can be visited.
#[derive(Clone, Copy, Debug)]
struct Piece {
    track: usize,
    start: usize,
    end: usize,
}

#[derive(Clone, Copy, Debug)]
struct Cursor {
    visit: u64,
    track: usize,
    position: usize,
    end: usize,
    /// Samples before this one have no weight.
    counts_from: usize,
}

/// Fills batches: each lane walks from visit to visit.
pub struct Walk {
    seed: u64,
    lanes: usize,
    chunk: usize,
    settling: usize,
    middle_starts: f32,
    pieces: Vec<Piece>,
    cursors: Vec<Option<Cursor>>,
    order: Vec<usize>,
    order_epoch: Option<u64>,
}

impl Walk {
    /// A walk over the training parts of tracks.
    #[must_use]
    pub fn new(tracks: &[Track], config: &TrainConfig, seed: u64) -> Self {
        let mut pieces = Vec::new();
        for (index, track) in tracks.iter().enumerate() {
            let count = track.len().div_ceil(config.longest_visit).max(1);
            let edge = |piece: usize| track.len() * piece / count;
            let all = (0..count).map(|piece| Piece { track: index, start: edge(piece), end: edge(piece + 1) });
            pieces.extend(all.filter(|piece| track.training[piece.start..piece.end].contains(&true)));
        }
        Self {
            seed,
            lanes: config.lanes,
            chunk: config.chunk,
            settling: config.settling_samples,
            middle_starts: config.middle_starts,
            order: (0..pieces.len()).collect(),
            pieces,
            cursors: vec![None; config.lanes],
            order_epoch: None,
        }
    }

    /// Fills the next batch from the tracks, whose network targets are `(output - front_end) / target_scale`.
    pub fn fill(&mut self, tracks: &[Track], target_scale: f32, batch: &mut Batch) {
        let (steps, width) = (batch.steps, batch.width);
        for lane in 0..self.lanes {
            let (cursor, fresh) = self.advance(lane);
            batch.reset[lane] = fresh;
            let track = &tracks[cursor.track];
            let end = cursor.end.min(cursor.position + steps);
            let count = end - cursor.position;
            let features = &mut batch.features[lane * steps * width..][..steps * width];
            features[..count * width].copy_from_slice(&track.features[cursor.position * width..end * width]);
            features[count * width..].fill(0.0);
            for step in 0..steps {
                let row = lane * steps + step;
                let sample = cursor.position + step;
                let known = step < count;
                batch.slack[row] = if known { track.slack[sample] / target_scale } else { 0.0 };
                batch.targets[row] = if known { (track.output[sample] - track.front_end[sample]) / target_scale } else { 0.0 };
                batch.weights[row] = if known && sample >= cursor.counts_from && track.training[sample] { 1.0 } else { 0.0 };
            }
        }
    }

    /// Moves on by `batches` batches without filling them, to resume.
    pub fn skip(&mut self, batches: u64) {
        for _ in 0..batches {
            for lane in 0..self.lanes {
                self.advance(lane);
            }
        }
    }

    /// The lane's next chunk, and whether it starts a visit.
    fn advance(&mut self, lane: usize) -> (Cursor, bool) {
        if let Some(mut cursor) = self.cursors[lane] {
            cursor.position += self.chunk;
            if cursor.position < cursor.end {
                self.cursors[lane] = Some(cursor);
                return (cursor, false);
            }
        }
        let visit = self.cursors[lane].map_or(0, |cursor| cursor.visit + 1);
        let cursor = self.begin(lane, visit);
        self.cursors[lane] = Some(cursor);
        (cursor, true)
    }

    fn begin(&mut self, lane: usize, visit: u64) -> Cursor {
        // All lanes' visits together go through one shuffled list of pieces after another.
        let number = visit * self.lanes as u64 + lane as u64;
        let count = self.pieces.len() as u64;
        let (epoch, place) = (number / count, number % count);
        if self.order_epoch != Some(epoch) {
            self.order.sort_unstable();
            self.order.shuffle(&mut stream(self.seed, Purpose::Order, epoch));
            self.order_epoch = Some(epoch);
        }
        let piece = self.pieces[self.order[usize::try_from(place).expect("smaller than the number of pieces")]];
        let mut random = stream(self.seed, Purpose::Visit, number);
        let slack = (piece.end - piece.start).saturating_sub(self.settling + self.chunk);
        let shift = if random.random::<f32>() < self.middle_starts && slack > 0 { random.random_range(1..=slack) } else { 0 };
        let start = piece.start + shift;
        if start == 0 {
            Cursor { visit, track: piece.track, position: 0, end: piece.end, counts_from: 0 }
        } else {
            // A start in the middle settles on the samples before it as far as there are any.
            let position = start.saturating_sub(self.settling);
            Cursor { visit, track: piece.track, position, end: piece.end, counts_from: position + self.settling }
        }
    }
}

/// Features of one step of the window that ends at sample `end`.
#[must_use]
pub fn window_features(track: &Track, width: usize, end: usize, length: usize, step: usize) -> &[f32] {
    &track.features[window_sample(end, length, step) * width..][..width]
}

/// Windows of a fixed length, each with one target at its end, in shuffled order: the paper's training. Before a track's first sample
/// the input is taken to have rested there, as the estimator does.
pub struct Windows {
    seed: u64,
    lanes: usize,
    length: usize,
    /// Track and last sample of each window.
    ends: Vec<(usize, usize)>,
    next: u64,
    order: Vec<usize>,
    order_epoch: Option<u64>,
}

impl Windows {
    /// All windows that end in the training parts of tracks.
    #[must_use]
    pub fn new(tracks: &[Track], length: usize, lanes: usize, seed: u64) -> Self {
        let mut ends = Vec::new();
        for (index, track) in tracks.iter().enumerate() {
            let last = (0..track.len()).filter(|&end| track.training[end]);
            ends.extend(last.map(|end| (index, end)));
        }
        Self { seed, lanes, length, order: (0..ends.len()).collect(), ends, next: 0, order_epoch: None }
    }

    /// Number of windows.
    #[must_use]
    pub fn count(&self) -> usize {
        self.ends.len()
    }

    /// Fills the next batch.
    pub fn fill(&mut self, tracks: &[Track], target_scale: f32, batch: &mut Batch) {
        let (steps, width) = (batch.steps, batch.width);
        batch.weights.fill(0.0);
        for lane in 0..self.lanes {
            let count = self.ends.len() as u64;
            let (epoch, place) = (self.next / count, self.next % count);
            self.next += 1;
            if self.order_epoch != Some(epoch) {
                self.order.sort_unstable();
                self.order.shuffle(&mut stream(self.seed, Purpose::Order, epoch));
                self.order_epoch = Some(epoch);
            }
            let (track, end) = self.ends[self.order[usize::try_from(place).expect("smaller than the number of windows")]];
            let track = &tracks[track];
            batch.reset[lane] = true;
            let features = &mut batch.features[lane * steps * width..][..steps * width];
            for (step, target) in features.chunks_exact_mut(width).enumerate() {
                target.copy_from_slice(window_features(track, width, end, self.length, step));
            }
            let row = lane * steps + steps - 1;
            batch.targets[row] = (track.output[end] - track.front_end[end]) / target_scale;
            batch.slack[row] = track.slack[end] / target_scale;
            batch.weights[row] = 1.0;
        }
    }

    /// Moves on by `batches` batches without filling them, to resume.
    pub fn skip(&mut self, batches: u64) {
        self.next += batches * self.lanes as u64;
    }
}
