//! Unknowns of a fit as parameters and as one vector.

use cape_core::{
    joints::JOINTS,
    optimise::{LbfgsOptions, Minimum, minimise},
};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Length of a pose.
pub(crate) const POSE: usize = 3 * JOINTS;

/// Offsets of translation, pose and shape in the vector of unknowns; a latent code follows them.
pub(crate) const TRANSL_AT: usize = 0;
pub(crate) const POSE_AT: usize = 3;
pub(crate) const BETAS_AT: usize = POSE_AT + POSE;

/// Scales of the unknowns in the optimisation, which move the surface by similar amounts: metres,
/// radians, standard deviations.
const TRANSL_SCALE: f64 = 0.03;
const POSE_SCALE: f64 = 0.1;
const OTHER_SCALE: f64 = 1.0;

/// Parameters of a body: translation, pose and shape.
///
/// ```
/// use cape_fit::BodyParameters;
///
/// let mut body = BodyParameters::new(vec![0.0; 72], vec![1.5])?;
/// body.transl = [0.0, 0.2, -3.0];
/// // A pose has 72 numbers.
/// assert!(BodyParameters::new(vec![0.0; 69], Vec::new()).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyParameters {
    /// Translation in the frame of the camera or the scan, metres, `[3]`.
    pub transl: [f64; 3],
    /// Pose in axis-angle, radians, `[72]`; the first three numbers are the global orientation.
    pub pose: Vec<f64>,
    /// Shape coefficients β.
    pub betas: Vec<f64>,
}

impl BodyParameters {
    /// A body at the origin with a pose `[72]`, radians, and shape coefficients.
    ///
    /// # Errors
    /// If the pose has another length, or a number is not finite.
    pub fn new(pose: Vec<f64>, betas: Vec<f64>) -> Result<Self> {
        let parameters = Self { transl: [0.0; 3], pose, betas };
        parameters.check()?;
        Ok(parameters)
    }

    /// An error unless the pose has 72 numbers and all numbers are finite.
    pub(crate) fn check(&self) -> Result<()> {
        if self.pose.len() != POSE {
            return Err(Error::argument(format!(
                "body: a pose of {} numbers, expected {POSE}",
                self.pose.len()
            )));
        }
        let mut numbers = self.transl.iter().chain(&self.pose).chain(&self.betas);
        if numbers.all(|x| x.is_finite()) {
            return Ok(());
        }
        Err(Error::argument("body: translation, pose or betas are not finite"))
    }

    /// Vector of unknowns, `[3 + 72 + betas]`.
    pub(crate) fn to_vector(&self) -> Vec<f64> {
        [&self.transl[..], &self.pose, &self.betas].concat()
    }

    /// Parameters of the first `[3 + 72 + betas]` unknowns of a vector.
    pub(crate) fn from_vector(x: &[f64], betas: usize) -> Self {
        Self {
            transl: [x[0], x[1], x[2]],
            pose: x[POSE_AT..BETAS_AT].to_vec(),
            betas: x[BETAS_AT..BETAS_AT + betas].to_vec(),
        }
    }
}

/// Translation of a vector of unknowns, metres.
pub(crate) fn transl(x: &[f64]) -> DVec3 {
    DVec3::from_slice(&x[TRANSL_AT..])
}

/// Scale of the unknown `at` of the vector of one body in the optimisation.
pub(crate) fn scale(at: usize) -> f64 {
    match at {
        _ if at < POSE_AT => TRANSL_SCALE,
        _ if at < BETAS_AT => POSE_SCALE,
        _ => OTHER_SCALE,
    }
}

/// Minimises an energy over the unknowns of one body whose index `free` accepts, scaled to similar
/// effects.
pub(crate) fn solve(
    x: &[f64],
    free: impl Fn(usize) -> bool,
    options: &LbfgsOptions,
    energy: impl FnMut(&[f64], &mut [f64]) -> Result<f64>,
) -> Result<Minimum> {
    let scales: Vec<f64> = (0..x.len()).map(|at| if free(at) { scale(at) } else { 0.0 }).collect();
    solve_scaled(x, &scales, options, energy)
}

/// Minimises an energy over unknowns divided by `scales`; those of scale 0 are fixed.
pub(crate) fn solve_scaled(
    x: &[f64],
    scales: &[f64],
    options: &LbfgsOptions,
    mut energy: impl FnMut(&[f64], &mut [f64]) -> Result<f64>,
) -> Result<Minimum> {
    let at = |changes: &[f64]| -> Vec<f64> {
        x.iter().zip(changes).zip(scales).map(|((x, c), s)| x + c * s).collect()
    };
    let found = minimise(vec![0.0; x.len()], options, |changes, gradient| {
        let value = energy(&at(changes), gradient)?;
        gradient.iter_mut().zip(scales).for_each(|(g, s)| *g *= s);
        Ok::<_, Error>(value)
    })?;
    Ok(Minimum { x: at(&found.x), ..found })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_and_names_agree() {
        let mut body = BodyParameters::new(vec![0.5; 72], vec![1.0, 2.0]).unwrap();
        body.transl = [1.0, 2.0, 3.0];
        let vector = body.to_vector();
        assert_eq!((vector.len(), vector[BETAS_AT + 1]), (77, 2.0));
        assert_eq!(BodyParameters::from_vector(&vector, 2), body);
        assert!(BodyParameters::new(vec![0.0; 69], vec![]).is_err());
        assert!(BodyParameters::new(vec![0.0; 72], vec![f64::NAN]).is_err());
    }

    #[test]
    fn only_free_unknowns_move() {
        let x = vec![1.0; 80];
        let found = solve(
            &x,
            |at| at % 2 == 0,
            &LbfgsOptions::default(),
            |x, g| {
                g.copy_from_slice(x);
                Ok(0.5 * x.iter().map(|x| x * x).sum::<f64>())
            },
        );
        for (at, x) in found.unwrap().x.iter().enumerate() {
            let expected = if at % 2 == 0 { 0.0 } else { 1.0 };
            assert!((x - expected).abs() < 1e-4, "{at} {x}");
        }
    }
}
