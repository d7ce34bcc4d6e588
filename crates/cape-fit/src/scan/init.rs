//! Initial bodies of a fit to a scan.

use cape_core::SmplModel;
use cape_synth::poses::preset;
use glam::{DMat3, DQuat, DVec3};

use super::{KnownJoints, energy::ScanTarget, rigid, rigid::RigidTransform};
use crate::{
    BodyParameters, Error, LbfgsOptions, PosePrior, Result, Skeleton,
    body_energy::{BodyWeights, prior_terms},
    parameters::solve,
};

/// Energy of a placement along another up axis, relative to the given one, below which the scan is
/// rejected.
const OTHER_WAY: f64 = 0.6;
/// Number of poses that are placed along the other up axes.
const OTHERS: usize = 3;
/// Weights of the pose prior in the stages of the fit to known joints.
const JOINT_STAGES: [f64; 3] = [10.0, 2.0, 0.5];

/// Prior knowledge of the pose of a scanned body.
///
/// ```
/// use cape_fit::{PosePrior, scan::ScanInit};
///
/// // Common poses, if nothing is known.
/// let start = ScanInit::default_poses(&PosePrior::synthetic()?);
/// assert!(matches!(start, ScanInit::Poses(poses) if poses.iter().all(|pose| pose.len() == 72)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum ScanInit {
    /// Candidate poses in axis-angle, radians, `[72]` each, global orientation included; the
    /// placement is estimated.
    Poses(Vec<Vec<f64>>),
    /// Known joint positions.
    Joints(KnownJoints),
    /// A body in an approximate pose and placement.
    Body(BodyParameters),
}

impl ScanInit {
    /// Common poses: A-pose, T-pose and the means of the pose prior.
    pub fn default_poses(prior: &PosePrior) -> Self {
        let often = prior.means().rows().into_iter();
        let often = often.map(|pose| [&[0.0; 3], &pose.to_vec()[..]].concat());
        let standing = ["a-pose", "t-pose"].iter().filter_map(|name| preset(name));
        let standing = standing.map(|pose| pose.map(f64::from).to_vec());
        Self::Poses(standing.chain(often).collect())
    }
}

/// Up axis of a scan.
///
/// ```
/// use cape_fit::scan::UpAxis;
/// use glam::DVec3;
///
/// let up: UpAxis = "-z".parse()?;
/// assert!((up.to_y() * DVec3::NEG_Z - DVec3::Y).length() < 1e-12);
/// assert_eq!((up.name(), UpAxis::Y.name()), ("-z", "y"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UpAxis {
    axis: usize,
    negative: bool,
}

impl UpAxis {
    /// Up axis +y, as in SMPL.
    pub const Y: Self = Self { axis: 1, negative: false };

    const ALL: [Self; 6] = {
        const fn up(axis: usize, negative: bool) -> UpAxis {
            UpAxis { axis, negative }
        }
        [up(1, false), up(1, true), up(2, false), up(2, true), up(0, false), up(0, true)]
    };

    /// Name, such as `-z`.
    pub const fn name(self) -> &'static str {
        match (self.axis, self.negative) {
            (0, false) => "x",
            (0, true) => "-x",
            (1, false) => "y",
            (1, true) => "-y",
            (_, false) => "z",
            (_, true) => "-z",
        }
    }

    /// Rotation from this axis to +y.
    pub fn to_y(self) -> DQuat {
        DQuat::from_rotation_arc(self.direction(), DVec3::Y)
    }

    pub(crate) fn direction(self) -> DVec3 {
        if self.negative { -DVec3::AXES[self.axis] } else { DVec3::AXES[self.axis] }
    }
}

impl std::str::FromStr for UpAxis {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|up| up.name() == text.trim_start_matches('+'));
        known.ok_or_else(|| {
            Error::argument(format!("axis `{text}`, expected x, y, z, -x, -y or -z"))
        })
    }
}

/// Body model and priors of a fit to a scan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScanSubject<'a> {
    pub(crate) body: &'a SmplModel,
    pub(crate) skeleton: &'a Skeleton,
    pub(crate) prior: &'a PosePrior,
    /// Number of shape coefficients to fit.
    pub(crate) betas: usize,
    /// Initial clothing displacements, metres, `[V, 3]`.
    pub(crate) clothes: &'a ndarray::Array2<f64>,
}

impl ScanInit {
    /// Largest number of bodies of [`initial_bodies`], and number of its calls of `placed`.
    pub(crate) fn count(&self, most: usize) -> [usize; 2] {
        match self {
            Self::Poses(poses) => [poses.len().min(most), poses.len() + OTHERS.min(poses.len())],
            Self::Joints(_) | Self::Body(_) => [1, 0],
        }
    }
}

/// At most `count` initial bodies in order of ascending energy; `placed` is called after each
/// placement.
pub(crate) fn initial_bodies(
    subject: &ScanSubject<'_>,
    target: &ScanTarget<'_>,
    start: &ScanInit,
    up: UpAxis,
    count: usize,
    placed: &mut dyn FnMut(),
) -> Result<Vec<BodyParameters>> {
    match start {
        ScanInit::Body(body) => {
            body.check()?;
            let mut body = body.clone();
            body.betas.resize(subject.betas, 0.0);
            Ok(vec![body])
        }
        ScanInit::Joints(joints) => Ok(vec![init_from_joints(subject, joints)?]),
        ScanInit::Poses(poses) => init_from_poses(subject, target, poses, up, count, placed),
    }
}

fn init_from_poses(
    subject: &ScanSubject<'_>,
    target: &ScanTarget<'_>,
    poses: &[Vec<f64>],
    up: UpAxis,
    count: usize,
    placed: &mut dyn FnMut(),
) -> Result<Vec<BodyParameters>> {
    let faces = &subject.body.faces;
    let (mut found, mut surfaces) = (Vec::new(), Vec::new());
    for pose in poses {
        let body = BodyParameters::new(pose.clone(), vec![0.0; subject.betas])?;
        let vertices = surface(subject, &body)?;
        if let Some(placing) = rigid::place(target, &vertices, faces, up.direction())
            && placing.energy.is_finite()
        {
            found.push((apply_rigid(subject, &body, &placing.rigid), placing.energy));
        }
        surfaces.push(vertices);
        placed();
    }
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    let Some(&(_, least)) = found.first() else {
        return Err(Error::Failed("scan fit: no initial pose can be placed in the scan".into()));
    };
    let mut best = (up, f64::INFINITY);
    for vertices in surfaces.iter().take(OTHERS) {
        for &other in UpAxis::ALL.iter().filter(|&&other| other != up) {
            let placing = rigid::place(target, vertices, faces, other.direction());
            if let Some(placing) = placing.filter(|placing| placing.energy < best.1) {
                best = (other, placing.energy);
            }
        }
        placed();
    }
    let (other, energy) = best;
    if energy < OTHER_WAY * least {
        let how = if other.axis == up.axis { "upside down" } else { "on its side" };
        return Err(Error::Observation(format!(
            "scan: the person is {how}: up axis {1}, but {0} fits better: use --up {0}",
            other.name(),
            up.name()
        )));
    }
    Ok(found.into_iter().take(count).map(|(body, _)| body).collect())
}

/// Body fitted to known joints from the means of the pose prior; the fit of lowest energy.
fn init_from_joints(subject: &ScanSubject<'_>, joints: &KnownJoints) -> Result<BodyParameters> {
    let weights = JOINT_STAGES.map(|pose| BodyWeights { pose, ..<_>::default() });
    let options = LbfgsOptions { steps: 100, gain: 1e-6, ..<_>::default() };
    let mut best: Option<(Vec<f64>, f64)> = None;
    for pose in subject.prior.means().rows() {
        let pose = [&[0.0; 3], &pose.to_vec()[..]].concat();
        let body = BodyParameters::new(pose, vec![0.0; subject.betas])?;
        let posed = subject.skeleton.pose(&body.betas, &body.pose, DVec3::ZERO)?;
        let pairs = joints.positions().iter().map(|&(joint, at)| (posed.joints()[joint], at, 1.0));
        let pairs: Vec<_> = pairs.collect();
        let Some(rigid) = RigidTransform::between(&pairs) else { continue };
        let mut x = apply_rigid(subject, &body, &rigid).to_vector();
        let mut value = f64::INFINITY;
        for weights in &weights {
            let found = solve(
                &x,
                |_| true,
                &options,
                |x, gradient| {
                    let priors = prior_terms(subject.prior, x, subject.betas, weights, gradient);
                    let seen = joints.energy(
                        subject.skeleton,
                        x,
                        subject.betas,
                        0.02,
                        weights.joints,
                        gradient,
                    )?;
                    Ok(priors.weighted(weights) + weights.joints * seen)
                },
            )?;
            (x, value) = (found.x, found.value);
        }
        if value.is_finite() && best.as_ref().is_none_or(|(_, least)| value < *least) {
            best = Some((x, value));
        }
    }
    let (x, _) = best.ok_or_else(|| {
        Error::Observation("joints: all in one place, expected the joints of a person".into())
    })?;
    Ok(BodyParameters::from_vector(&x, subject.betas))
}

/// Vertices of a body in the initial clothing, metres, `[V]`.
fn surface(subject: &ScanSubject<'_>, body: &BodyParameters) -> Result<Vec<DVec3>> {
    let posed = subject.body.pose(&body.betas, &body.pose, body.transl, Some(subject.clothes))?;
    Ok(crate::alignment::points(posed.vertices.view()))
}

/// The body after a rigid transform.
fn apply_rigid(
    subject: &ScanSubject<'_>,
    body: &BodyParameters,
    rigid: &RigidTransform,
) -> BodyParameters {
    let pelvis = subject.skeleton.rest(&body.betas)[0];
    let own = DQuat::from_scaled_axis(DVec3::from_slice(&body.pose[..3]));
    let turn = DMat3::from_quat(own);
    let orientation = DQuat::from_mat3(&(rigid.rotation * turn)).to_scaled_axis();
    let mut moved = body.clone();
    moved.pose[..3].copy_from_slice(&orientation.to_array());
    let at = rigid.apply(pelvis + DVec3::from_array(body.transl));
    moved.transl = (at - pelvis).to_array();
    moved
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;
    use crate::{
        scan::{Scan, Unit},
        testing::BODY,
    };

    fn with_subject<T>(work: impl FnOnce(&ScanSubject<'_>) -> T) -> T {
        let clothes = Array2::zeros(BODY.v_template.dim());
        work(&ScanSubject {
            body: &BODY,
            skeleton: &Skeleton::new(&BODY).unwrap(),
            prior: &PosePrior::synthetic().unwrap(),
            betas: 10,
            clothes: &clothes,
        })
    }

    fn walking() -> BodyParameters {
        let pose = cape_synth::poses::preset("walk").unwrap().map(f64::from).to_vec();
        BodyParameters {
            transl: [1.0, 2.0, 0.5],
            ..BodyParameters::new(pose, vec![0.0; 10]).unwrap()
        }
    }

    #[test]
    fn moving_a_body_moves_its_surface() {
        with_subject(|subject| {
            let body = walking();
            let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.4, -1.0, 2.0)));
            let rigid = RigidTransform { rotation: turn, translation: DVec3::new(1.0, 0.0, -3.0) };
            let before = surface(subject, &body).unwrap();
            let after = surface(subject, &apply_rigid(subject, &body, &rigid)).unwrap();
            for (&before, after) in before.iter().zip(after) {
                assert!(rigid.apply(before).distance(after) < 1e-9);
            }
        });
    }

    #[test]
    fn bodies_are_found_by_their_joints() {
        with_subject(|subject| {
            let body = walking();
            let posed = BODY.pose(&body.betas, &body.pose, body.transl, None).unwrap().joints;
            let at = |row: ndarray::ArrayView1<f64>| Some(DVec3::new(row[0], row[1], row[2]));
            let mut joints: Vec<_> = posed.rows().into_iter().map(at).collect();
            joints[20] = None;
            let known = KnownJoints::new(&joints).unwrap();
            let found = init_from_joints(subject, &known).unwrap();
            let posed =
                subject.skeleton.pose(&found.betas, &found.pose, DVec3::from_array(found.transl));
            for &(joint, at) in known.positions() {
                assert!(posed.as_ref().unwrap().joints()[joint].distance(at) < 0.02);
            }
        });
    }

    #[test]
    fn upside_down_scans_are_rejected() {
        with_subject(|subject| {
            let body = walking();
            let upside_down: Vec<DVec3> = surface(subject, &body)
                .unwrap()
                .iter()
                .map(|v| DVec3::new(v.x, -v.y, -v.z))
                .collect();
            let scan = Scan::new(upside_down, None, Vec::new(), Unit::M).unwrap();
            let target = ScanTarget::new(&scan, 1000, 1);
            let start = ScanInit::Poses(vec![body.pose.clone()]);
            let message = initial_bodies(subject, &target, &start, UpAxis::Y, 1, &mut || {})
                .unwrap_err()
                .to_string();
            assert!(message.contains("upside down") && message.contains("--up -y"), "{message}");
            let up = "-y".parse().unwrap();
            assert_eq!(
                initial_bodies(subject, &target, &start, up, 3, &mut || {}).unwrap().len(),
                1
            );
            assert!("w".parse::<UpAxis>().is_err());
        });
    }
}
