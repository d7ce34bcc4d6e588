//! A line search for the strong Wolfe conditions (Nocedal & Wright 2006, algorithms 3.5 and 3.6).

/// Constant `c₁` of the sufficient-decrease condition.
const DECREASE: f64 = 1e-4;
/// Constant `c₂` of the curvature condition.
const CURVATURE: f64 = 0.9;
/// Largest number of evaluations per search.
const EVALUATIONS: usize = 25;
/// Growth factor of the step while the function decreases.
const EXPANSION: f64 = 3.0;

/// Sample of the function on the search line.
#[derive(Debug, Clone)]
pub(super) struct Point {
    /// Step length along the direction.
    pub(super) step: f64,
    /// Value of the function; infinite outside its domain.
    pub(super) value: f64,
    /// Derivative along the direction.
    pub(super) slope: f64,
    /// Gradient of the function.
    pub(super) gradient: Vec<f64>,
}

/// Finds a step from `start` (step 0, negative slope) that satisfies the strong Wolfe conditions, or,
/// after [`EVALUATIONS`], the lowest sample with sufficient decrease; `None` if there is none.
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
        let too_high = !decreases(&point) || (low.step > 0.0 && point.value >= low.value);
        if too_high {
            high = Some(point);
        } else if flat(&point) {
            return Ok(Some(point));
        } else {
            // The minimum lies between this sample and the one that its slope points to.
            let past_minimum = match &high {
                None => point.slope > 0.0,
                Some(high) => point.slope * (high.step - low.step) >= 0.0,
            };
            if past_minimum {
                high = Some(std::mem::replace(&mut low, point));
            } else {
                low = point;
            }
        }
        step = match &high {
            None => EXPANSION * step,
            Some(high) => interpolate(&low, high),
        };
        if high.as_ref().is_some_and(|high| (high.step - low.step).abs() <= 1e-12 * first) {
            break;
        }
    }
    Ok((low.step > 0.0).then_some(low))
}

/// Minimum of the cubic through both samples and slopes, at least a tenth of the interval from both.
fn interpolate(low: &Point, high: &Point) -> f64 {
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
        /// On a quartic with a bounded domain, from any first step.
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
    fn no_step_is_found_without_a_decrease() {
        // The slope of the start is wrong: the function increases.
        let start = Point { step: 0.0, value: 1.0, slope: -1.0, gradient: vec![] };
        let at = |step: f64| Ok::<_, Infallible>(point(step, |x| 1.0 + x, |_| 1.0));
        assert!(search(&start, 1.0, at).unwrap().is_none());
    }
}
