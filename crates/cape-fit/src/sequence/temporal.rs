//! Temporal term of a sequence.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::vector::SequenceLayout;
use crate::{
    Error, Result, Skeleton,
    parameters::{BETAS_AT, POSE_AT, transl},
};

/// Standard deviations of how a person moves between frames.
///
/// ```
/// use cape_fit::TemporalConfig;
///
/// let config = TemporalConfig { frame_rate: 25.0, ..TemporalConfig::default() };
/// assert_eq!(config.acceleration, 10.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TemporalConfig {
    /// Frames per second.
    pub frame_rate: f64,
    /// Standard deviation of the acceleration of a joint, m/s².
    pub acceleration: f64,
    /// Standard deviation of the rate of change of a joint's axis-angle, rad/s.
    pub rotation: f64,
    /// Standard deviation of the velocity of a joint relative to the pelvis, m/s, by which one of the
    /// bodies that explain a frame equally well is chosen.
    pub velocity: f64,
}

impl Default for TemporalConfig {
    fn default() -> Self {
        Self { frame_rate: 30.0, acceleration: 10.0, rotation: 5.0, velocity: 1.0 }
    }
}

impl TemporalConfig {
    pub(super) fn check(&self) -> Result<()> {
        let Self { frame_rate, acceleration, rotation, velocity } = *self;
        for (field, value) in [
            ("frame_rate", frame_rate),
            ("acceleration", acceleration),
            ("rotation", rotation),
            ("velocity", velocity),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::argument(format!(
                    "configuration: `{field}` {value}, expected above 0"
                )));
            }
        }
        Ok(())
    }
}

/// Temporal term
/// `E_T = Σ_f Σ_j ‖J_j(f−1) − 2 J_j(f) + J_j(f+1)‖² / (2 σ_a² Δt⁴) + Σ_f ‖θ(f+1) − θ(f)‖² / (2 σ_ω² Δt²)`
/// over the joints `J` and the body poses `θ` without the global orientation, which the joints
/// determine.
///
/// Returns the value at the unknowns of a sequence; the gradient is added to `gradient`.
pub(super) fn temporal_energy(
    skeleton: &Skeleton,
    layout: SequenceLayout,
    config: &TemporalConfig,
    x: &[f64],
    gradient: &mut [f64],
) -> Result<f64> {
    let interval = 1.0 / config.frame_rate;
    let by_acceleration = 0.5 / (config.acceleration * interval * interval).powi(2);
    let by_rotation = 0.5 / (config.rotation * interval).powi(2);
    let vectors: Vec<Vec<f64>> = (0..layout.frames).map(|frame| layout.frame(x, frame)).collect();
    let posed = vectors.iter().map(|x| {
        let betas = &x[BETAS_AT..BETAS_AT + layout.betas];
        skeleton.pose(betas, &x[POSE_AT..BETAS_AT], transl(x))
    });
    let posed = posed.collect::<Result<Vec<_>>>()?;
    let joints = skeleton.joints();
    let mut forces = vec![vec![DVec3::ZERO; joints]; layout.frames];
    let mut value = 0.0;
    for frame in 1..layout.frames.saturating_sub(1) {
        let [before, now, after] = [frame - 1, frame, frame + 1].map(|at| posed[at].joints());
        for (joint, ((a, b), c)) in before.iter().zip(now).zip(after).enumerate() {
            let change = *a - 2.0 * *b + *c;
            value += by_acceleration * change.length_squared();
            let force = 2.0 * by_acceleration * change;
            for (at, share) in [(frame - 1, 1.0), (frame, -2.0), (frame + 1, 1.0)] {
                forces[at][joint] += share * force;
            }
        }
    }
    for (frame, (posed, forces)) in posed.iter().zip(&forces).enumerate() {
        let by = posed.pull_back(forces);
        let mut of_frame: Vec<f64> =
            by.transl.to_array().into_iter().chain(by.pose).chain(by.betas).collect();
        of_frame.resize(BETAS_AT + layout.betas + layout.latent, 0.0);
        layout.add(gradient, frame, &of_frame);
    }
    for frame in 1..layout.frames {
        for angle in POSE_AT + 3..BETAS_AT {
            let [before, now] = [frame - 1, frame].map(|frame| frame * BETAS_AT + angle);
            let change = x[now] - x[before];
            value += by_rotation * change * change;
            gradient[now] += 2.0 * by_rotation * change;
            gradient[before] -= 2.0 * by_rotation * change;
        }
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    use super::*;
    use crate::{
        sequence::vector::join,
        testing::{BODY, assert_gradient},
    };

    #[test]
    fn gradients_agree_with_finite_differences() {
        let skeleton = Skeleton::new(&BODY).unwrap();
        let layout = SequenceLayout { frames: 4, betas: 3, latent: 2 };
        let config = TemporalConfig::default();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let x: Vec<f64> = (0..4 * 75 + 3 + 2).map(|_| rng.random_range(-0.5..0.5)).collect();
        let value = |x: &[f64], gradient: &mut [f64]| {
            temporal_energy(&skeleton, layout, &config, x, gradient).unwrap()
        };
        let mut gradient = vec![0.0; x.len()];
        value(&x, &mut gradient);
        assert_gradient(&x, &gradient, 1e-6, |x| value(x, &mut vec![0.0; x.len()]));
    }

    /// A body that keeps its pose on a straight line has no energy; 1 m/s² of its 24 joints has
    /// 24 / 2 σ².
    #[test]
    fn uniform_motion_is_free() {
        let skeleton = Skeleton::new(&BODY).unwrap();
        let layout = SequenceLayout { frames: 3, betas: 1, latent: 0 };
        let config = TemporalConfig { acceleration: 2.0, ..TemporalConfig::default() };
        let value = |path: [f64; 3]| {
            let bodies = path.map(|z| crate::BodyParameters {
                transl: [0.3, 0.0, z],
                pose: vec![0.2; 72],
                betas: Vec::new(),
            });
            let x = join(&bodies, &[0.7], &[]);
            temporal_energy(&skeleton, layout, &config, &x, &mut vec![0.0; x.len()]).unwrap()
        };
        assert!(value([0.0, 0.1, 0.2]) < 1e-20);
        let accelerated = value([0.0, 0.0, 1.0 / 900.0]);
        assert!((accelerated - 24.0 / 8.0).abs() < 1e-9, "{accelerated}");
    }
}
