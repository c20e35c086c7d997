//! What one optimiser step is made from.

/// One chunk for all lanes: what goes in, what should come out, and how much each sample counts.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Sequences side by side.
    pub lanes: usize,
    /// Steps of the chunk.
    pub steps: usize,
    /// Network inputs of a step.
    pub width: usize,
    /// `[lane][step][feature]`.
    pub features: Vec<f32>,
    /// `[lane][step]`, what the network should give.
    pub targets: Vec<f32>,
    /// `[lane][step]`, how far off an output may be at no cost.
    pub slack: Vec<f32>,
    /// `[lane][step]`, weight of the squared error; 0 leaves the sample out.
    pub weights: Vec<f32>,
    /// Lanes that start from zero state.
    pub reset: Vec<bool>,
}

impl Batch {
    /// An empty batch: zero features, targets and weights.
    #[must_use]
    pub fn new(lanes: usize, steps: usize, width: usize) -> Self {
        Self {
            lanes,
            steps,
            width,
            features: vec![0.0; lanes * steps * width],
            targets: vec![0.0; lanes * steps],
            slack: vec![0.0; lanes * steps],
            weights: vec![0.0; lanes * steps],
            reset: vec![true; lanes],
        }
    }
}
