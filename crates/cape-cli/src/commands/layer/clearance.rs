//! Distance of written clothing from the body.

use cape_layer::InsideShares;
use clap::Args;

use crate::options::non_negative;

/// Option of the distance from the body.
#[derive(Debug, Clone, Copy, Args)]
pub(super) struct ClearanceArgs {
    /// Least distance of the clothing from the body, mm; 0 leaves it where it is.
    #[arg(long, default_value_t = 2.0, value_name = "MM", value_parser = non_negative)]
    clearance: f64,
}

impl ClearanceArgs {
    /// Least distance, metres, if clothing is pushed out.
    pub(super) fn distance(self) -> Option<f64> {
        (self.clearance > 0.0).then_some(1e-3 * self.clearance)
    }
}

/// Sum of the shares of clothing inside the body over frames.
#[derive(Default)]
pub(super) struct InsideSum {
    sum: InsideShares,
    frames: usize,
}

impl InsideSum {
    pub(super) fn push(&mut self, shares: InsideShares) {
        self.sum.before += shares.before;
        self.sum.after += shares.after;
        self.frames += 1;
    }

    /// Means over the frames, if there are any.
    pub(super) fn means(&self) -> Option<InsideShares> {
        let mean = |sum: f64| sum / self.frames as f64;
        let InsideShares { before, after } = self.sum;
        (self.frames > 0).then(|| InsideShares { before: mean(before), after: mean(after) })
    }
}

/// A line of text with the shares, if there are any.
pub(super) fn inside_text(inside: Option<InsideShares>) -> String {
    inside.map_or(String::new(), |InsideShares { before, after }| {
        let [before, after] = [before, after].map(|share| 100.0 * share);
        format!(
            "surface of the clothing inside the body: {before:.2} %, after it was pushed out \
             {after:.2} %\n"
        )
    })
}
