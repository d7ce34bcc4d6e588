//! Values over a training of any length, in bounded memory.

/// Points kept of a curve; more than any terminal has columns to show.
const MOST: usize = 1024;

/// A curve that keeps means over ever more values as it grows.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    /// Values in a point.
    stride: usize,
    full: Vec<(f64, f64)>,
    /// Sums of both coordinates of the point that is not full yet, and their count.
    open: (f64, f64, usize),
    smoother: Smoother,
}

impl Curve {
    /// A curve of moving means over about `window` values; 1 for the values themselves.
    pub(super) fn smoothed(window: f64) -> Self {
        let smoother = Smoother::new(window);
        Self { stride: 1, full: Vec::new(), open: (0.0, 0.0, 0), smoother }
    }

    /// Adds a value; one that is not finite is passed over.
    pub(super) fn push(&mut self, x: f64, value: f64) {
        if !value.is_finite() {
            return;
        }
        let y = self.smoother.push(value);
        let (sum_x, sum_y, count) = self.open;
        self.open = (sum_x + x, sum_y + y, count + 1);
        if self.open.2 < self.stride {
            return;
        }
        self.full.extend(self.open_point());
        self.open = (0.0, 0.0, 0);
        if self.full.len() == MOST {
            let mean = |a: f64, b: f64| f64::midpoint(a, b);
            let halved = self.full.chunks_exact(2).map(|pair| {
                let [(x0, y0), (x1, y1)] = [pair[0], pair[1]];
                (mean(x0, x1), mean(y0, y1))
            });
            self.full = halved.collect();
            self.stride *= 2;
        }
    }

    pub(super) fn points(&self) -> Vec<(f64, f64)> {
        self.full.iter().copied().chain(self.open_point()).collect()
    }

    /// The moving mean as it is.
    pub(super) fn last(&self) -> Option<f64> {
        self.smoother.value()
    }

    fn open_point(&self) -> Option<(f64, f64)> {
        let (x, y, count) = self.open;
        (count > 0).then(|| (x / count as f64, y / count as f64))
    }
}

/// An exponential moving mean that is right from the first value on.
#[derive(Debug, Clone)]
struct Smoother {
    decay: f64,
    sum: f64,
    weight: f64,
}

impl Smoother {
    fn new(window: f64) -> Self {
        Self { decay: 1.0 - 1.0 / window.max(1.0), sum: 0.0, weight: 0.0 }
    }

    fn push(&mut self, value: f64) -> f64 {
        self.sum = self.decay * self.sum + (1.0 - self.decay) * value;
        self.weight = self.decay * self.weight + (1.0 - self.decay);
        self.sum / self.weight
    }

    fn value(&self) -> Option<f64> {
        (self.weight > 0.0).then(|| self.sum / self.weight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_curve_keeps_its_shape_in_bounded_memory() {
        let mut curve = Curve::smoothed(1.0);
        for x in 0..100_000 {
            curve.push(f64::from(x), 3.0 * f64::from(x));
        }
        let points = curve.points();
        assert!((MOST / 2..=MOST).contains(&points.len()), "{}", points.len());
        assert!(points.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert!(points.iter().all(|(x, y)| (y - 3.0 * x).abs() < 1e-6 * y.max(1.0)));
        assert_eq!(curve.last(), Some(299_997.0));
    }

    #[test]
    fn smoothing_starts_at_the_first_value_and_forgets_it() {
        let mut curve = Curve::smoothed(10.0);
        curve.push(0.0, 5.0);
        assert_eq!(curve.last(), Some(5.0));
        curve.push(1.0, f64::NAN);
        for x in 0..200 {
            curve.push(f64::from(x), 1.0);
        }
        assert!((curve.last().unwrap() - 1.0).abs() < 1e-6);
    }
}
