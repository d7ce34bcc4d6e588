use std::collections::VecDeque;

use ndarray::Array1;

/// Limited-memory BFGS (Nocedal and Wright 2006, algorithm 7.5) with a line search for the strong
/// Wolfe conditions (algorithms 3.5 and 3.6).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lbfgs {
    /// Pairs of steps and changes of gradient that are kept.
    pub memory: usize,
    /// Iterations at most.
    pub iterations: usize,
    /// Largest number of the gradient that counts as a minimum.
    pub tolerance: f64,
    /// Sufficient decrease, Wolfe's c₁.
    pub decrease: f64,
    /// Curvature, Wolfe's c₂.
    pub curvature: f64,
}

impl Default for Lbfgs {
    fn default() -> Self {
        Self { memory: 20, iterations: 500, tolerance: 1e-8, decrease: 1e-4, curvature: 0.9 }
    }
}

/// A function's value and gradient.
pub type Objective<'a> = dyn FnMut(&Array1<f64>) -> (f64, Array1<f64>) + 'a;

/// Where a minimisation ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// The place.
    pub at: Array1<f64>,
    /// The value there.
    pub value: f64,
    /// Iterations taken.
    pub iterations: usize,
    /// Whether the gradient is below the tolerance.
    pub converged: bool,
}

/// A point of the search: place, value, gradient.
#[derive(Debug, Clone)]
struct Point {
    at: Array1<f64>,
    value: f64,
    gradient: Array1<f64>,
}

impl Lbfgs {
    /// Minimises `f`, which gives a value and its gradient, from `start`. `go_on` sees every
    /// iterate and its value, and ends the search by `false`.
    pub fn minimise(
        &self,
        start: Array1<f64>,
        f: &mut Objective<'_>,
        go_on: &mut dyn FnMut(usize, &Array1<f64>, f64) -> bool,
    ) -> Minimum {
        let (value, gradient) = f(&start);
        let mut here = Point { at: start, value, gradient };
        let mut history: VecDeque<(Array1<f64>, Array1<f64>)> = VecDeque::new();
        let mut iterations = 0;
        while iterations < self.iterations && !self.is_flat(&here) {
            let mut direction = descent(&here.gradient, &history);
            if direction.dot(&here.gradient) >= 0.0 {
                history.clear();
                direction = -&here.gradient;
            }
            let first =
                if history.is_empty() { 1.0 / length(&here.gradient).max(1.0) } else { 1.0 };
            let Some(next) = self.search(&here, &direction, first, f) else {
                if history.is_empty() {
                    break;
                }
                history.clear();
                continue;
            };
            let (step, change) = (&next.at - &here.at, &next.gradient - &here.gradient);
            if step.dot(&change) > 1e-14 * length(&step) * length(&change) {
                if history.len() == self.memory.max(1) {
                    history.pop_front();
                }
                history.push_back((step, change));
            }
            here = next;
            iterations += 1;
            if !go_on(iterations, &here.at, here.value) {
                break;
            }
        }
        let converged = self.is_flat(&here);
        Minimum { at: here.at, value: here.value, iterations, converged }
    }

    fn is_flat(&self, point: &Point) -> bool {
        point.gradient.iter().all(|g| g.abs() <= self.tolerance)
    }

    /// A point along `direction` that fulfils the strong Wolfe conditions.
    fn search(
        &self,
        from: &Point,
        direction: &Array1<f64>,
        first: f64,
        f: &mut Objective<'_>,
    ) -> Option<Point> {
        let slope = from.gradient.dot(direction);
        let mut probe = |step: f64| {
            let at = &from.at + &(direction * step);
            let (value, gradient) = f(&at);
            (Trial { step, value, slope: gradient.dot(direction) }, Point { at, value, gradient })
        };
        let too_high = |t: &Trial| {
            !t.value.is_finite() || t.value > from.value + self.decrease * t.step * slope
        };
        let mut before = Trial { step: 0.0, value: from.value, slope };
        let mut step = first;
        for round in 0..20 {
            let (trial, point) = probe(step);
            if too_high(&trial) || (round > 0 && trial.value >= before.value) {
                return self.zoom(before, trial, slope, &too_high, &mut probe);
            }
            if trial.slope.abs() <= -self.curvature * slope {
                return Some(point);
            }
            if trial.slope >= 0.0 {
                return self.zoom(trial, before, slope, &too_high, &mut probe);
            }
            before = trial;
            step *= 2.0;
        }
        None
    }

    /// Narrows an interval that holds such a point; `low` is the end of lower value.
    fn zoom(
        &self,
        mut low: Trial,
        mut high: Trial,
        slope: f64,
        too_high: &dyn Fn(&Trial) -> bool,
        probe: &mut dyn FnMut(f64) -> (Trial, Point),
    ) -> Option<Point> {
        let mut best = None;
        for _ in 0..30 {
            let (trial, point) = probe(between(&low, &high));
            if too_high(&trial) || trial.value >= low.value {
                high = trial;
            } else {
                if trial.slope.abs() <= -self.curvature * slope {
                    return Some(point);
                }
                if trial.slope * (high.step - low.step) >= 0.0 {
                    high = low;
                }
                low = trial;
                best = Some(point);
            }
            if (high.step - low.step).abs() <= 1e-14 * low.step.abs().max(1e-14) {
                break;
            }
        }
        best
    }
}

/// A step along the line, with the value there and the slope along the line.
#[derive(Debug, Clone, Copy)]
struct Trial {
    step: f64,
    value: f64,
    slope: f64,
}

/// The minimum of the parabola through two trials, kept away from the interval's ends.
fn between(low: &Trial, high: &Trial) -> f64 {
    let width = high.step - low.step;
    let bend = high.value - low.value - low.slope * width;
    let share = -low.slope * width / (2.0 * bend);
    if share.is_finite() {
        low.step + width * share.clamp(0.1, 0.9)
    } else {
        low.step + 0.5 * width
    }
}

/// Minus the gradient times the inverse Hessian that the history describes (algorithm 7.4).
fn descent(gradient: &Array1<f64>, history: &VecDeque<(Array1<f64>, Array1<f64>)>) -> Array1<f64> {
    let mut q = gradient.clone();
    let mut shares = Vec::with_capacity(history.len());
    for (step, change) in history.iter().rev() {
        let share = step.dot(&q) / step.dot(change);
        q.scaled_add(-share, change);
        shares.push(share);
    }
    if let Some((step, change)) = history.back() {
        q *= step.dot(change) / change.dot(change);
    }
    for ((step, change), share) in history.iter().zip(shares.into_iter().rev()) {
        let back = change.dot(&q) / step.dot(change);
        q.scaled_add(share - back, step);
    }
    -q
}

fn length(vector: &Array1<f64>) -> f64 {
    vector.dot(vector).sqrt()
}
