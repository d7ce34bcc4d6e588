/// The pose in which offsets are measured, the paper's θ₀.
///
/// ```
/// use cape_core::smpl::StandardPose;
///
/// assert_eq!(StandardPose::T.angles(24), [0.0; 72]);
/// // The shoulders alone are turned, by 45°.
/// let lowered = StandardPose::A.angles(24);
/// let turned: Vec<f64> = lowered.into_iter().filter(|angle| *angle != 0.0).collect();
/// assert_eq!(turned.len(), 2);
/// assert!((turned[0].abs().to_degrees() - 45.0).abs() < 1e-9);
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub enum StandardPose {
    /// Arms lowered by 45°.
    #[default]
    A,
    /// SMPL's rest pose.
    T,
    /// Any axis-angles, `[3 · joints]`, radians.
    Other(Vec<f64>),
}

impl StandardPose {
    /// The pose's axis-angles, `[3 · joints]`, radians.
    pub fn angles(&self, joints: usize) -> Vec<f64> {
        let mut pose = vec![0.0; 3 * joints];
        match self {
            Self::T => {}
            Self::Other(angles) => pose.clone_from(angles),
            Self::A => {
                // The shoulders, about z.
                for (joint, turn) in [(16, -1.0), (17, 1.0)] {
                    if let Some(angle) = pose.get_mut(3 * joint + 2) {
                        *angle = turn * std::f64::consts::FRAC_PI_4;
                    }
                }
            }
        }
        pose
    }
}
