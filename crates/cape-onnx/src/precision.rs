//! Numbers of the weights in a graph.

/// Numbers that a graph keeps its weights in; it computes in single precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WeightPrecision {
    /// Half precision: half the size.
    Half,
    /// Single precision, as in training.
    #[default]
    Single,
}
