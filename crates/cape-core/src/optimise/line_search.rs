//! A line search for the strong Wolfe conditions (Nocedal & Wright 2006, algorithms 3.5 and 3.6).

/// Share of the slope that a step must at least gain.
const DECREASE: f64 = 1e-4;
/// Share of the slope that may be left.
const CURVATURE: f64 = 0.9;
/// Evaluations in one search.
const EVALUATIONS: usize = 25;
/// How much longer each next step is while the function still falls.
const EXPANSION: f64 = 3.0;

/// A point on the line.
#[derive(Debug, Clone)]
pub(super) struct Point {
    /// Distance along the direction.
    pub(super) step: f64,
    /// Value of the function; infinite where it has none.
    pub(super) value: f64,
    /// Derivative along the direction.
    pub(super) slope: f64,
    /// The gradient there.
    pub(super) gradient: Vec<f64>,
}

/// Finds a step from `start`, which is at 0 and goes downhill, that satisfies the strong Wolfe
/// conditions; or, where none is found in time, the lowest that was seen to decrease the function.
/// `None` if there is none.
pub(super) fn search<E>(
    start: &Point,
    first: f64,
    mut at: impl FnMut(f64) -> Result<Point, E>,
) -> Result<Option<Point>, E> {
    let decreases =
        |point: &Point| point.value <= start.value + DECREASE * point.step * start.slope;
    let flat = |point: &Point| point.slope.abs() <= -CURVATURE * start.slope;
    let mut low = start.clone();
    let mut high: Option<Point> = None;
    let mut step = first;
    for _ in 0..EVALUATIONS {
        let point = at(step)?;
        let worse = !decreases(&point) || (low.step > 0.0 && point.value >= low.value);
        if worse {
            high = Some(point);
        } else if flat(&point) {
            return Ok(Some(point));
        } else {
            // The minimum lies between this point and the one that its slope points to.
            let turned = match &high {
                None => point.slope > 0.0,
                Some(high) => point.slope * (high.step - low.step) >= 0.0,
            };
            if turned {
                high = Some(std::mem::replace(&mut low, point));
            } else {
                low = point;
            }
        }
        step = match &high {
            None => EXPANSION * step,
            Some(high) => between(&low, high),
        };
        if high.as_ref().is_some_and(|high| (high.step - low.step).abs() <= 1e-12 * first) {
            break;
        }
    }
    Ok((low.step > 0.0).then_some(low))
}

/// The minimum of the cubic through both points with their slopes, kept away from both.
fn between(low: &Point, high: &Point) -> f64 {
    let width = high.step - low.step;
    let middle = low.step + 0.5 * width;
    if !(high.value.is_finite() && high.slope.is_finite()) {
        return low.step + 0.1 * width;
    }
    let d = low.slope + high.slope - 3.0 * (high.value - low.value) / width;
    let root = d * d - low.slope * high.slope;
    if root < 0.0 {
        return middle;
    }
    let root = root.sqrt().copysign(width);
    let share = 1.0 - (high.slope + root - d) / (high.slope - low.slope + 2.0 * root);
    if share.is_finite() { low.step + share.clamp(0.1, 0.9) * width } else { middle }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use proptest::prelude::*;

    use super::*;

    fn point(step: f64, f: impl Fn(f64) -> f64, d: impl Fn(f64) -> f64) -> Point {
        Point { step, value: f(step), slope: d(step), gradient: vec![] }
    }

    proptest! {
        /// On a quartic with a cliff: the conditions hold, whatever the first step.
        #[test]
        fn steps_satisfy_the_strong_wolfe_conditions(
            centre in 0.1f64..20.0, bend in 0.0f64..3.0, first in 0.001f64..100.0,
        ) {
            let cliff = 1.5 * centre + 1.0;
            let f = |x: f64| {
                let u = x - centre;
                if x > cliff { f64::INFINITY } else { u * u + 0.1 * bend * u.powi(4) }
            };
            let d = |x: f64| {
                let u = x - centre;
                if x > cliff { f64::NAN } else { 2.0 * u + 0.4 * bend * u.powi(3) }
            };
            let start = point(0.0, f, d);
            let at = |step: f64| Ok::<_, Infallible>(point(step, f, d));
            let found = search(&start, first, at).unwrap().unwrap();
            prop_assert!(found.value <= start.value + DECREASE * found.step * start.slope);
            prop_assert!(found.slope.abs() <= -CURVATURE * start.slope);
        }
    }

    #[test]
    fn without_a_decrease_there_is_no_step() {
        // The slope lies.
        let start = Point { step: 0.0, value: 1.0, slope: -1.0, gradient: vec![] };
        let at = |step: f64| Ok::<_, Infallible>(point(step, |x| 1.0 + x, |_| 1.0));
        assert!(search(&start, 1.0, at).unwrap().is_none());
    }
}
