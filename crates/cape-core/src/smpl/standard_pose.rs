/// Standard pose θ₀ (Yang et al. 2018) in which offsets from the body are measured.
///
/// Its A-pose lowers the arms by 45°, half-way between the T-pose and hanging arms, so that sleeves
/// and armpits are equally far from both. The pose named `a-pose` for pictures and captures
/// (`cape_synth::poses`) lowers them by 0.8 rad ≈ 46°; stored offsets depend on this one, so that
/// the two stay separate.
///
/// ```
/// use cape_core::smpl::StandardPose;
///
/// assert_eq!(StandardPose::T.angles(24), [0.0; 72]);
/// // Only the shoulders are rotated, by 45°.
/// let lowered = StandardPose::A.angles(24);
/// let turned: Vec<f64> = lowered.into_iter().filter(|angle| *angle != 0.0).collect();
/// assert_eq!(turned.len(), 2);
/// assert!((turned[0].abs().to_degrees() - 45.0).abs() < 1e-9);
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub enum StandardPose {
    /// A-pose: arms lowered by 45°.
    #[default]
    A,
    /// T-pose, SMPL's rest pose.
    T,
    /// Pose in axis-angle, radians, `[3 · joints]`.
    Other(Vec<f64>),
}

/// Angle of the arms below the horizontal in [`StandardPose::A`], radians.
const A_POSE_ANGLE: f64 = std::f64::consts::FRAC_PI_4;

impl StandardPose {
    /// The pose in axis-angle, radians, `[3 · joints]`.
    pub fn angles(&self, joints: usize) -> Vec<f64> {
        let mut pose = vec![0.0; 3 * joints];
        match self {
            Self::T => {}
            Self::Other(angles) => pose.clone_from(angles),
            Self::A => {
                // Rotations of the shoulders about z.
                for (shoulder, sign) in [(16, -1.0), (17, 1.0)] {
                    if let Some(angle) = pose.get_mut(3 * shoulder + 2) {
                        *angle = sign * A_POSE_ANGLE;
                    }
                }
            }
        }
        pose
    }
}
