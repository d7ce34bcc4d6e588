//! Minimisation by limited-memory BFGS (Nocedal & Wright 2006, algorithm 7.5) of functions of vectors.
//!
//! Burn's L-BFGS optimises the tensors of a module in `f32`. The objectives here are evaluated in
//! `f64` and may be infinite in parts of their domain, which the line search must handle.

mod line_search;

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use line_search::{Point, search};

/// Options of L-BFGS: history and convergence criteria.
///
/// ```
/// use std::convert::Infallible;
///
/// use cape_core::optimise::{LbfgsOptions, StopReason, minimise};
///
/// // Rosenbrock's function, whose minimum is at (1, 1).
/// let options = LbfgsOptions { gain: 0.0, ..LbfgsOptions::default() };
/// let minimum = minimise(vec![-1.2, 1.0], &options, |x, gradient| {
///     let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
///     gradient.copy_from_slice(&[-2.0 * a - 400.0 * x[0] * b, 200.0 * b]);
///     Ok::<_, Infallible>(a * a + 100.0 * b * b)
/// })?;
/// assert_eq!(minimum.stop, StopReason::Gradient);
/// assert!(minimum.x.iter().all(|x| (x - 1.0).abs() < 1e-5));
/// assert!(minimum.curve.is_sorted_by(|before, after| before >= after));
/// # Ok::<(), Infallible>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LbfgsOptions {
    /// Number of curvature pairs kept.
    pub history: usize,
    /// Largest number of iterations.
    pub steps: usize,
    /// Gradient tolerance: converged if no component exceeds it.
    pub gradient: f64,
    /// Relative decrease of the objective per iteration below which it has converged.
    pub gain: f64,
}

impl Default for LbfgsOptions {
    fn default() -> Self {
        Self { history: 20, steps: 200, gradient: 1e-6, gain: 1e-9 }
    }
}

/// Reason why a minimisation stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// Converged: the gradient is below the tolerance.
    Gradient,
    /// Converged: the objective no longer decreases.
    Gain,
    /// The line search found no decrease.
    LineSearchFailed,
    /// Iteration limit reached.
    Steps,
    /// Stopped by the callback.
    Callback,
}

/// Result of a minimisation.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// Position of the minimum.
    pub x: Vec<f64>,
    /// Value of the objective there.
    pub value: f64,
    /// Values of the objective at the start and after each iteration.
    pub curve: Vec<f64>,
    /// Number of evaluations of the objective.
    pub evaluations: usize,
    /// Reason for stopping.
    pub stop: StopReason,
}

/// Minimises `function` from `x`. The function writes its gradient and returns its value, which may
/// be infinite or NaN outside its domain.
///
/// # Errors
/// Errors of the function.
pub fn minimise<E>(
    x: Vec<f64>,
    options: &LbfgsOptions,
    function: impl FnMut(&[f64], &mut [f64]) -> Result<f64, E>,
) -> Result<Minimum, E> {
    minimise_while(x, options, function, |_, _| true)
}

/// [`minimise`] that stops when `keep_going(x, value)`, called after each iteration, returns false.
///
/// # Errors
/// Errors of the function.
pub fn minimise_while<E>(
    x: Vec<f64>,
    options: &LbfgsOptions,
    mut function: impl FnMut(&[f64], &mut [f64]) -> Result<f64, E>,
    mut keep_going: impl FnMut(&[f64], f64) -> bool,
) -> Result<Minimum, E> {
    let mut evaluations = 0;
    let mut evaluate = |x: &[f64], direction: &[f64], step: f64| -> Result<Point, E> {
        let moved: Vec<f64> = x.iter().zip(direction).map(|(x, d)| x + step * d).collect();
        let mut gradient = vec![0.0; x.len()];
        let value = function(&moved, &mut gradient)?;
        evaluations += 1;
        let slope = dot(&gradient, direction);
        let finite = value.is_finite() && gradient.iter().all(|g| g.is_finite());
        Ok(Point { step, value: if finite { value } else { f64::INFINITY }, slope, gradient })
    };
    let mut x = x;
    let mut history = LbfgsHistory { pairs: VecDeque::new(), capacity: options.history.max(1) };
    let mut now = evaluate(&x, &vec![0.0; x.len()], 0.0)?;
    let mut curve = vec![now.value];
    let (steps, mut stop) = if now.value.is_finite() {
        (options.steps, StopReason::Steps)
    } else {
        (0, StopReason::LineSearchFailed)
    };
    for _ in 0..steps {
        let steepest = now.gradient.iter().fold(0.0f64, |most, g| most.max(g.abs()));
        if steepest <= options.gradient {
            stop = StopReason::Gradient;
            break;
        }
        let mut direction = history.direction(&now.gradient);
        now.slope = dot(&now.gradient, &direction);
        if now.slope >= 0.0 {
            history.pairs.clear();
            direction = now.gradient.iter().map(|g| -g).collect();
            now.slope = -dot(&now.gradient, &now.gradient);
        }
        let first = if history.pairs.is_empty() { 1.0 / (1.0 + steepest) } else { 1.0 };
        now.step = 0.0;
        let Some(next) = search(&now, first, |step| evaluate(&x, &direction, step))? else {
            if history.pairs.is_empty() {
                stop = StopReason::LineSearchFailed;
                break;
            }
            // The history may be misleading: restart with steepest descent.
            history.pairs.clear();
            continue;
        };
        let change: Vec<f64> = direction.iter().map(|d| next.step * d).collect();
        let gradient_change = next.gradient.iter().zip(&now.gradient).map(|(a, b)| a - b).collect();
        x.iter_mut().zip(&change).for_each(|(x, d)| *x += d);
        history.push(change, gradient_change);
        let gain = now.value - next.value;
        now = next;
        curve.push(now.value);
        if !keep_going(&x, now.value) {
            stop = StopReason::Callback;
            break;
        }
        if gain <= options.gain * now.value.abs().max(1e-12) {
            stop = StopReason::Gain;
            break;
        }
    }
    Ok(Minimum { x, value: now.value, curve, evaluations, stop })
}

/// Curvature pairs: changes of position and gradient, newest last.
struct LbfgsHistory {
    pairs: VecDeque<(Vec<f64>, Vec<f64>)>,
    capacity: usize,
}

impl LbfgsHistory {
    /// Adds a pair, unless its curvature is not positive.
    fn push(&mut self, s: Vec<f64>, y: Vec<f64>) {
        if dot(&s, &y) <= 1e-12 * dot(&y, &y).sqrt() * dot(&s, &s).sqrt() {
            return;
        }
        if self.pairs.len() == self.capacity {
            self.pairs.pop_front();
        }
        self.pairs.push_back((s, y));
    }

    /// Quasi-Newton direction by the two-loop recursion.
    fn direction(&self, gradient: &[f64]) -> Vec<f64> {
        let mut q: Vec<f64> = gradient.iter().map(|g| -g).collect();
        let mut alphas = Vec::with_capacity(self.pairs.len());
        for (s, y) in self.pairs.iter().rev() {
            let alpha = dot(s, &q) / dot(s, y);
            add_scaled(&mut q, -alpha, y);
            alphas.push(alpha);
        }
        if let Some((s, y)) = self.pairs.back() {
            let scale = dot(s, y) / dot(y, y);
            for q in &mut q {
                *q *= scale;
            }
        }
        for ((s, y), alpha) in self.pairs.iter().zip(alphas.iter().rev()) {
            let beta = dot(y, &q) / dot(s, y);
            add_scaled(&mut q, alpha - beta, s);
        }
        q
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add_scaled(to: &mut [f64], scale: f64, from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += scale * from);
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    use super::*;

    fn run(x: Vec<f64>, f: impl Fn(&[f64], &mut [f64]) -> f64) -> Minimum {
        let options = LbfgsOptions { gain: 0.0, gradient: 1e-9, ..LbfgsOptions::default() };
        minimise(x, &options, |x, g| Ok::<_, Infallible>(f(x, g))).unwrap()
    }

    #[test]
    fn rosenbrocks_function_is_minimised() {
        let found = run(vec![-1.2, 1.0, -1.2, 1.0], |x, g| {
            let mut sum = 0.0;
            for pair in 0..2 {
                let (a, b) = (x[2 * pair], x[2 * pair + 1]);
                let (u, v) = (1.0 - a, b - a * a);
                sum += u * u + 100.0 * v * v;
                g[2 * pair] = -2.0 * u - 400.0 * a * v;
                g[2 * pair + 1] = 200.0 * v;
            }
            sum
        });
        assert!(found.x.iter().all(|x| (x - 1.0).abs() < 1e-8), "{found:?}");
        assert!(found.evaluations < 100, "{}", found.evaluations);
        assert!(found.curve.windows(2).all(|pair| pair[1] <= pair[0]));
    }

    #[test]
    fn infinite_values_and_errors_are_handled() {
        // −ln x + x is undefined for x ≤ 0.
        let found = run(vec![50.0], |x, g| {
            g[0] = 1.0 - 1.0 / x[0];
            x[0] - x[0].ln()
        });
        assert!((found.x[0] - 1.0).abs() < 1e-6, "{found:?}");
        let nowhere = run(vec![1.0], |_, _| f64::NAN);
        assert_eq!(nowhere.stop, StopReason::LineSearchFailed);
        let failed = minimise(vec![1.0], &LbfgsOptions::default(), |_, _| Err("broken"));
        assert_eq!(failed.unwrap_err(), "broken");
    }

    #[test]
    fn ill_conditioned_quadratic_forms_are_minimised() {
        let scales: Vec<f64> = (0..30).map(|k| 1.2f64.powi(k - 10)).collect();
        let centre: Vec<f64> = (0..30).map(|k| f64::from(k).sin()).collect();
        let options = LbfgsOptions { gain: 0.0, gradient: 1e-8, ..LbfgsOptions::default() };
        let function = |x: &[f64], g: &mut [f64]| {
            let mut sum = 0.0;
            for k in 0..30 {
                let off = x[k] - centre[k];
                g[k] = scales[k] * off;
                sum += 0.5 * scales[k] * off * off;
            }
            Ok::<_, Infallible>(sum)
        };
        let found = minimise(vec![0.0; 30], &options, function).unwrap();
        assert_eq!(found.stop, StopReason::Gradient, "{found:?}");
        assert!(found.x.iter().zip(&centre).all(|(x, c)| (x - c).abs() < 1e-5));
        assert!(found.evaluations < 400, "{}", found.evaluations);

        let some = minimise_while(vec![0.0; 30], &options, function, |_, value| value > 1.0);
        let some = some.unwrap();
        assert_eq!(some.stop, StopReason::Callback);
        assert!(some.value <= 1.0 && some.curve[some.curve.len() - 2] > 1.0);
    }

    #[test]
    fn every_iteration_decreases_the_objective() {
        let options = LbfgsOptions { gain: 0.0, gradient: 1e-8, ..LbfgsOptions::default() };
        let found = minimise(vec![-1.2, 1.0], &options, |x, g| {
            let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
            g.copy_from_slice(&[-2.0 * a - 400.0 * x[0] * b, 200.0 * b]);
            Ok::<_, Infallible>(a * a + 100.0 * b * b)
        })
        .unwrap();
        assert!(found.stop == StopReason::Gradient && found.curve.len() <= 60, "{found:?}");
        assert!(found.x.iter().all(|x| (x - 1.0).abs() < 1e-7));
        assert!(found.curve.windows(2).all(|pair| pair[1] < pair[0]));
    }

    #[test]
    fn the_line_search_handles_domain_boundaries() {
        let found = run(vec![9.0], |x, g| {
            if x[0] <= 0.0 {
                g[0] = f64::NAN;
                return f64::INFINITY;
            }
            g[0] = 1.0 - 1.0 / x[0];
            x[0] - x[0].ln()
        });
        assert!((found.x[0] - 1.0).abs() < 1e-7, "{found:?}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// Reference: the linear system of the minimum of a quadratic form.
        #[test]
        fn quadratic_forms_are_solved(
            entries in prop::collection::vec(-1.0f64..1.0, 36),
            right in prop::collection::vec(-1.0f64..1.0, 6),
        ) {
            let a = DMatrix::from_vec(6, 6, entries);
            let h = &a * a.transpose() + DMatrix::identity(6, 6) * 0.1;
            let b = DVector::from_vec(right);
            let expected = h.clone().lu().solve(&b).unwrap();
            let found = run(vec![0.0; 6], |x, g| {
                let x = DVector::from_column_slice(x);
                let hx = &h * &x;
                g.copy_from_slice((&hx - &b).as_slice());
                0.5 * x.dot(&hx) - b.dot(&x)
            });
            for (found, expected) in found.x.iter().zip(expected.iter()) {
                prop_assert!((found - expected).abs() < 1e-6);
            }
        }
    }
}
