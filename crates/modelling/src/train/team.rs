//! The training threads: a batch is split by lanes, gradients are summed in a fixed order, each thread updates its part of the weights.
//!
//! The split depends on the number of threads alone and every sum has a fixed order, so equal seeds and equal thread counts give equal
//! bits.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::thread::JoinHandle;

use firmware::estimator::NetworkState;

use super::barrier::Barrier;
use super::batch::Batch;
use super::blocks::{Block, gather, scatter};
use super::eigenbasis::Eigenbasis;
use super::optimizer::{OptimizerConfig, Shard};
use super::quantised;
use super::shares::shares;
use super::tracks::beyond;
use crate::network::{Architecture, Layout, Sequence};

#[derive(Clone, Copy)]
enum Order {
    Step { learning_rate: f32, number: u64, total_weight: f64 },
    Stop,
}

struct Worker {
    lanes: Range<usize>,
    /// States of the fixed-point network, one a lane.
    fixed: Vec<NetworkState>,
    sequence: Sequence,
    parameters: Vec<f32>,
    loss: f64,
}

struct Shared {
    barrier: Barrier,
    optimizer: OptimizerConfig,
    order: RwLock<Order>,
    /// Present in quantisation-aware training: the largest magnitude of each layer's hidden state.
    largest_hidden: RwLock<Option<Vec<f64>>>,
    batch: RwLock<Batch>,
    workers: Vec<Mutex<Worker>>,
    gradients: Vec<RwLock<Vec<f32>>>,
    /// What each thread updates.
    blocks: Vec<Vec<Block>>,
    shards: Vec<RwLock<Shard>>,
    squared_norms: Vec<Mutex<f64>>,
}

// A poisoned lock means that a thread panicked; the barrier has then already passed the panic on, so the data are never used.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}
fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

/// Cuts `length` into `parts` pieces whose sizes differ by at most one.
fn split(length: usize, parts: usize) -> Vec<Range<usize>> {
    let edge = |part: usize| length * part / parts;
    (0..parts).map(|part| edge(part)..edge(part + 1)).collect()
}

/// Threads that make optimiser steps together; the caller's thread is one of them.
pub struct Team {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    architecture: Architecture,
    steps_made: u64,
}

/// Everything a team needs to go on exactly where another stopped.
#[derive(Clone, Debug, PartialEq)]
pub struct TeamState {
    /// Optimiser steps made.
    pub steps_made: u64,
    /// Parameters, in the order of [`Layout`].
    pub values: Vec<f32>,
    /// Their running average.
    pub average: Vec<f32>,
    /// Adam's running mean of the gradient.
    pub mean: Vec<f32>,
    /// Adam's running mean of the squared gradient.
    pub square: Vec<f32>,
    /// SOAP's coordinates, thread by thread.
    pub bases: Vec<Vec<f32>>,
    /// Network state of each thread's lanes.
    pub carried: Vec<Vec<f32>>,
}

impl Team {
    /// Starts the threads; `parameters` are in the order of [`Layout`].
    ///
    /// # Panics
    /// When `parameters` do not fit the architecture.
    #[must_use]
    pub fn new(
        architecture: &Architecture,
        parameters: &[f32],
        optimizer: OptimizerConfig,
        lanes: usize,
        steps: usize,
        threads: usize,
    ) -> Self {
        let layout = Layout::new(architecture);
        assert_eq!(parameters.len(), layout.len(), "parameters of the architecture");
        let threads = threads.clamp(1, lanes.max(1));
        let blocks = shares(&layout, optimizer.method, threads);
        let workers = split(lanes, threads).into_iter().map(|lanes| {
            Mutex::new(Worker {
                sequence: Sequence::new(architecture, lanes.len(), steps),
                fixed: vec![NetworkState::default(); lanes.len()],
                lanes,
                parameters: parameters.to_vec(),
                loss: 0.0,
            })
        });
        let shared = Arc::new(Shared {
            barrier: Barrier::new(threads),
            optimizer,
            order: RwLock::new(Order::Stop),
            largest_hidden: RwLock::new(None),
            batch: RwLock::new(Batch::new(lanes, steps, architecture.features)),
            workers: workers.collect(),
            gradients: (0..threads).map(|_| RwLock::new(vec![0.0; parameters.len()])).collect(),
            shards: blocks.iter().map(|blocks| RwLock::new(Shard::new(optimizer.method, blocks, &gather(blocks, parameters)))).collect(),
            blocks,
            squared_norms: (0..threads).map(|_| Mutex::new(0.0)).collect(),
        });
        let threads = (1..threads)
            .map(|index| {
                let shared = Arc::clone(&shared);
                std::thread::spawn(move || shared.serve(index))
            })
            .collect();
        Self { shared, threads, architecture: architecture.clone(), steps_made: 0 }
    }

    /// The batch, to be filled in before [`Self::step`].
    pub fn batch(&self) -> RwLockWriteGuard<'_, Batch> {
        write(&self.shared.batch)
    }

    /// Optimiser steps made.
    #[must_use]
    pub fn steps_made(&self) -> u64 {
        self.steps_made
    }

    /// Sizes and activation of the network.
    #[must_use]
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// One optimiser step on the batch; gives the weighted mean squared error before the step. Network states are carried to the next
    /// step in lanes that the next batch does not reset.
    pub fn step(&mut self, learning_rate: f32) -> f64 {
        self.steps_made += 1;
        let total_weight = read(&self.shared.batch).weights.iter().map(|&weight| f64::from(weight)).sum();
        *write(&self.shared.order) = Order::Step { learning_rate, number: self.steps_made, total_weight };
        let _watch = self.shared.barrier.watch();
        self.shared.barrier.wait();
        self.shared.work(0, learning_rate, self.steps_made, total_weight);
        self.shared.workers.iter().map(|worker| lock(worker).loss).sum()
    }

    /// From now on the forward pass is that of the fixed-point code; `largest_hidden` is the largest magnitude of each layer's hidden
    /// state in use.
    pub fn quantise(&mut self, largest_hidden: Vec<f64>) {
        *write(&self.shared.largest_hidden) = Some(largest_hidden);
    }

    /// The parameters in the order of [`Layout`].
    #[must_use]
    pub fn parameters(&self) -> Vec<f32> {
        self.whole(|shard| &shard.values)
    }

    /// The running average of the parameters.
    #[must_use]
    pub fn averaged_parameters(&self) -> Vec<f32> {
        self.whole(|shard| &shard.average)
    }

    /// Threads that train, the caller's among them.
    pub fn threads(&self) -> usize {
        self.shared.workers.len()
    }

    /// Gradient of the last step, before clipping, summed over the threads.
    #[must_use]
    pub fn last_gradient(&self) -> Vec<f32> {
        let mut sum = read(&self.shared.gradients[0]).clone();
        for gradient in &self.shared.gradients[1..] {
            sum.iter_mut().zip(read(gradient).iter()).for_each(|(sum, value)| *sum += value);
        }
        sum
    }

    fn whole(&self, part: impl Fn(&Shard) -> &Vec<f32>) -> Vec<f32> {
        let mut flat = vec![0.0; Layout::new(&self.architecture).len()];
        for (shard, blocks) in self.shared.shards.iter().zip(&self.shared.blocks) {
            scatter(blocks, part(&read(shard)), &mut flat);
        }
        flat
    }

    /// Everything needed to go on later.
    #[must_use]
    pub fn state(&self) -> TeamState {
        TeamState {
            steps_made: self.steps_made,
            values: self.whole(|shard| &shard.values),
            average: self.whole(|shard| &shard.average),
            mean: self.whole(|shard| &shard.mean),
            square: self.whole(|shard| &shard.square),
            bases: self.shared.shards.iter().map(|shard| read(shard).bases.iter().flat_map(Eigenbasis::state).collect()).collect(),
            carried: self.shared.workers.iter().map(|worker| lock(worker).sequence.carried_state()).collect(),
        }
    }

    /// Goes on from a state of a team of the same shape.
    ///
    /// # Panics
    /// When the state belongs to another architecture, batch or number of threads.
    pub fn restore(&mut self, state: &TeamState) {
        assert_eq!(state.carried.len(), self.shared.workers.len(), "threads of the checkpoint");
        self.steps_made = state.steps_made;
        for ((shard, blocks), bases) in self.shared.shards.iter().zip(&self.shared.blocks).zip(&state.bases) {
            let mut shard = write(shard);
            shard.values = gather(blocks, &state.values);
            shard.average = gather(blocks, &state.average);
            shard.mean = gather(blocks, &state.mean);
            shard.square = gather(blocks, &state.square);
            let mut rest = bases.as_slice();
            for basis in &mut shard.bases {
                rest = basis.restore(rest);
            }
        }
        for (worker, carried) in self.shared.workers.iter().zip(&state.carried) {
            lock(worker).sequence.restore_state(carried);
        }
    }
}

impl Drop for Team {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            *write(&self.shared.order) = Order::Stop;
            self.shared.barrier.wait();
        }
        for thread in self.threads.drain(..) {
            // A thread that panicked has already made the step panic.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn serve(&self, index: usize) {
        let _watch = self.barrier.watch();
        loop {
            self.barrier.wait();
            let order = *read(&self.order);
            match order {
                Order::Step { learning_rate, number, total_weight } => self.work(index, learning_rate, number, total_weight),
                Order::Stop => return,
            }
        }
    }

    /// One thread's share of an optimiser step.
    fn work(&self, index: usize, learning_rate: f32, number: u64, total_weight: f64) {
        self.differentiate(index, total_weight);
        self.barrier.wait();
        let gradient = self.reduce(index);
        self.barrier.wait();
        let squared: f64 = self.squared_norms.iter().map(|norm| *lock(norm)).sum();
        let norm = squared.sqrt();
        let clip = f64::from(self.optimizer.clip_norm);
        // A step from a gradient that is not finite would spoil the weights for good; it is left out.
        if norm.is_finite() {
            #[expect(clippy::cast_possible_truncation, reason = "a factor between 0 and 1")]
            let scale = if norm > clip { (clip / norm) as f32 } else { 1.0 };
            write(&self.shards[index]).update(&self.optimizer, &gradient, scale, learning_rate, number);
        }
        self.barrier.wait();
    }

    /// Forward and backward pass over the thread's lanes.
    fn differentiate(&self, index: usize, total_weight: f64) {
        let batch = read(&self.batch);
        let mut worker = lock(&self.workers[index]);
        let worker = &mut *worker;
        for (shard, blocks) in self.shards.iter().zip(&self.blocks) {
            scatter(blocks, &read(shard).values, &mut worker.parameters);
        }
        let (lanes, width) = (worker.lanes.len(), batch.width);
        let features = worker.sequence.features_mut(batch.steps);
        for (column, lane) in worker.lanes.clone().enumerate() {
            let source = &batch.features[lane * batch.steps * width..][..batch.steps * width];
            for (step, values) in source.chunks_exact(width).enumerate() {
                features[(step * lanes + column) * width..][..width].copy_from_slice(values);
            }
        }
        for (column, lane) in worker.lanes.clone().enumerate() {
            if batch.reset[lane] {
                worker.sequence.reset_lane(column);
                worker.fixed[column].reset();
            }
        }
        let largest_hidden = read(&self.largest_hidden);
        let rounded = largest_hidden
            .as_ref()
            .and_then(|largest| quantised::rounded(worker.sequence.architecture(), &worker.parameters, largest).ok());
        match rounded {
            Some((fixed, parameters)) => {
                worker.parameters = parameters;
                quantised::forward(&fixed, &mut worker.fixed, batch.steps, &mut worker.sequence);
            }
            // A weight beyond the format: the exporter says so at the end; until then f32 goes on.
            None => {
                worker.sequence.forward(&worker.parameters);
            }
        }
        let (outputs, gradient) = worker.sequence.outputs_and_gradient_mut();
        let mut loss = 0.0;
        for (column, lane) in worker.lanes.clone().enumerate() {
            for step in 0..batch.steps {
                let row = step * lanes + column;
                let place = lane * batch.steps + step;
                let error = beyond(f64::from(outputs[row] - batch.targets[place]), f64::from(batch.slack[place]));
                let share = f64::from(batch.weights[place]) / total_weight.max(f64::MIN_POSITIVE);
                loss += share * error * error;
                #[expect(clippy::cast_possible_truncation, reason = "the passes work in f32")]
                let slope = (2.0 * share * error) as f32;
                gradient[row] = slope;
            }
        }
        worker.loss = loss;
        worker.sequence.backward(&worker.parameters, &mut write(&self.gradients[index]));
        worker.sequence.carry();
    }

    /// Sums the thread's part of the gradient over all threads and notes its squared norm.
    fn reduce(&self, index: usize) -> Vec<f32> {
        let blocks = &self.blocks[index];
        let mut sum = gather(blocks, &read(&self.gradients[0]));
        for gradient in &self.gradients[1..] {
            sum.iter_mut().zip(gather(blocks, &read(gradient))).for_each(|(sum, value)| *sum += value);
        }
        let mut squares = [0.0f32; 16];
        let (blocks, rest) = sum.as_chunks::<16>();
        for block in blocks {
            for lane in 0..16 {
                squares[lane] += block[lane] * block[lane];
            }
        }
        let rest: f32 = rest.iter().map(|value| value * value).sum();
        *lock(&self.squared_norms[index]) = squares.iter().map(|&square| f64::from(square)).sum::<f64>() + f64::from(rest);
        sum
    }
}
