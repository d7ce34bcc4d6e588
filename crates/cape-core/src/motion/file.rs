//! Motions read from files, with the axis, rate and shape they say or leave to be found out.

use std::path::{Path, PathBuf};

use ndarray::Array2;

use super::{
    BodyMotion, UpAxis,
    clip::Clip,
    content::Content,
    people::{joined_frames, people},
};
use crate::{BodyPose, Error, Result, SmplModel, list_files};

/// Extensions of files of poses in a directory.
const EXTENSIONS: [&str; 6] = ["json", "npz", "npy", "pkl", "pickle", "smpl"];

/// Number of people that an error lists.
const LISTED: usize = 20;

/// Frame rate of files that say none, frames per second.
pub const DEFAULT_FRAME_RATE: f64 = 30.0;
/// Mean cosine of the body's uprightness with an axis, from which the body counts as standing along
/// it.
const STANDING: f64 = 0.5;
/// The same, from which it is believed against what a file's layout says.
const PLAINLY_STANDING: f64 = 0.9;

/// Point about which the first rotation of a pose turns the body.
///
/// ```
/// use cape_core::motion::{MotionOptions, Pivot, read_motion};
///
/// // EasyMocap: rotation `Rh` about the origin and translation `Th`.
/// let numbers = |count: usize| vec![0.0; count];
/// let person = serde_json::json!({
///     "id": 0, "poses": [numbers(72)], "shapes": [numbers(10)], "Rh": [[0.0, 3.0, 0.0]], "Th": [[0, 0, 1]]
/// });
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("000000.json");
/// std::fs::write(&path, serde_json::json!([person]).to_string())?;
/// let file = read_motion(&path, &MotionOptions::default())?;
/// assert_eq!((file.pivot, file.poses[(0, 1)]), (Pivot::Origin, 3.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Pivot {
    /// The rest position of the pelvis, as in SMPL.
    #[default]
    Pelvis,
    /// The origin, as in EasyMocap's parameters.
    Origin,
    /// The pelvis, whose place is the translation, as in CLOTH3D.
    PelvisAtOrigin,
}

/// Choices in reading a motion.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MotionOptions {
    /// Person, of files with several; the error without it lists them.
    pub person: Option<String>,
    /// Axis that points up in the file, if it is not to be found out.
    pub up: Option<UpAxis>,
}

/// Motion of a person in a file.
///
/// Poses and translations are in the file's coordinates; [`motion`](Self::motion) turns them.
///
/// ```
/// use cape_core::motion::{MotionOptions, UpAxis, read_motion};
/// use cape_core::npy::NpzWriter;
/// use ndarray::{Array1, Array2, arr0};
///
/// // AMASS: SMPL+H, 120 frames per second, z is up.
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("walk_poses.npz");
/// let mut poses = Array2::<f64>::zeros((240, 156));
/// poses.column_mut(0).fill(std::f64::consts::FRAC_PI_2);
/// let mut archive = NpzWriter::create(&path)?;
/// archive.add("poses", &poses)?;
/// archive.add("trans", &Array2::<f64>::zeros((240, 3)))?;
/// archive.add("betas", &Array1::<f64>::zeros(16))?;
/// archive.add("mocap_framerate", &arr0(120.0))?;
/// archive.finish()?;
///
/// let file = read_motion(&path, &MotionOptions::default())?;
/// assert_eq!((file.frames(), file.frame_rate, file.up), (240, Some(120.0), UpAxis::Z));
/// // At 30 frames per second, upright, for a body whose pelvis rests at the origin.
/// let motion = file.motion(Some(30.0), [0.0; 3])?;
/// assert_eq!(motion.frames(), 60);
/// assert!(motion.poses[(0, 0)].abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MotionFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Name of the person, if the file has several.
    pub person: Option<String>,
    /// Poses in axis-angle, radians, `[frames, 72]`; hands are zero unless the file is SMPL's.
    pub poses: Array2<f64>,
    /// Translations, metres, `[frames, 3]`, if the file has them.
    pub translations: Option<Array2<f64>>,
    /// Shape coefficients, means over the frames; empty if the file has none.
    pub betas: Vec<f64>,
    /// `male`, `female` or `neutral`, if the file says it.
    pub gender: Option<String>,
    /// Frames per second, if the file says it.
    pub frame_rate: Option<f64>,
    /// Number of joints of the file's body: 22, 24, 52 or 55.
    pub joints: usize,
    /// Axis that points up.
    pub up: UpAxis,
    /// Point about which the root turns the body.
    pub pivot: Pivot,
    /// Displacements of the rest vertices, metres, `[V, 3]`, of `.smpl` files that have them.
    pub offsets: Option<Array2<f64>>,
    /// Remarks on what was guessed and what the body has not, a sentence each.
    pub notes: Vec<String>,
}

impl MotionFile {
    /// A motion of this library, called `name`, in place of a file's.
    pub fn from_motion(name: impl Into<PathBuf>, motion: BodyMotion) -> Self {
        Self {
            path: name.into(),
            person: None,
            joints: motion.poses.ncols() / 3,
            poses: motion.poses,
            translations: Some(motion.translations),
            betas: Vec::new(),
            gender: None,
            frame_rate: Some(motion.frame_rate),
            up: UpAxis::Y,
            pivot: Pivot::Pelvis,
            offsets: None,
            notes: Vec::new(),
        }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.poses.nrows()
    }

    /// The motion with y up, at the file's frame rate ([`DEFAULT_FRAME_RATE`] if it says none),
    /// resampled to `frame_rate` if that is given. `pelvis` is the rest position of the pelvis of the
    /// body that is moved, metres.
    ///
    /// # Errors
    /// If a number is not finite, or the frame rate is not positive.
    pub fn motion(&self, frame_rate: Option<f64>, pelvis: [f64; 3]) -> Result<BodyMotion> {
        let rate = self.frame_rate.unwrap_or(DEFAULT_FRAME_RATE);
        let still = || Array2::zeros((self.frames(), 3));
        let translations = self.translations.clone().unwrap_or_else(still);
        let mut motion = BodyMotion::new(rate, self.poses.clone(), translations)?;
        match self.pivot {
            Pivot::Pelvis => {}
            Pivot::Origin => motion = motion.about_pelvis(pelvis),
            Pivot::PelvisAtOrigin => motion.translations -= &ndarray::arr1(&pelvis),
        }
        let motion = motion.turned_upright(self.up, pelvis);
        match frame_rate {
            Some(rate) => motion.resampled(rate),
            None => Ok(motion),
        }
    }

    /// [`motion`](Self::motion) for `body` with shape coefficients `betas`.
    ///
    /// # Errors
    /// As of [`motion`](Self::motion), or if the body has fewer shape coefficients.
    pub fn motion_of(
        &self,
        body: &SmplModel,
        betas: &[f64],
        frame_rate: Option<f64>,
    ) -> Result<BodyMotion> {
        let joints = body.rest_joints(&body.rest_shape(betas)?)?;
        self.motion(frame_rate, [0, 1, 2].map(|axis| joints[(0, axis)]))
    }

    /// The poses with y up, radians, `[frames][72]`.
    ///
    /// # Errors
    /// As of [`motion`](Self::motion).
    pub fn upright_poses(&self) -> Result<Vec<BodyPose>> {
        let motion = self.motion(None, [0.0; 3])?;
        Ok((0..motion.frames()).map(|frame| motion.pose(frame)).collect())
    }

    /// Name of a pose: that of the file, with the number of the frame if there are several.
    pub fn pose_name(&self, frame: usize) -> String {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        if self.frames() == 1 { stem.into_owned() } else { format!("{stem} {frame}") }
    }

    /// The first `count` shape coefficients, which a body of so many takes.
    pub fn betas_for(&self, count: usize) -> &[f64] {
        &self.betas[..self.betas.len().min(count)]
    }
}

/// Reads the motion of one person from a file in one of the formats of this module, or from a directory
/// with such a file for each frame.
///
/// # Errors
/// If the file cannot be read or holds no poses (the error lists its arrays), or several people of
/// whom `options` names none.
pub fn read_motion(path: impl AsRef<Path>, options: &MotionOptions) -> Result<MotionFile> {
    let path = path.as_ref();
    let mut people = read_motions(path, options)?;
    if people.len() == 1 {
        return Ok(people.remove(0));
    }
    let names: Vec<String> = people
        .iter()
        .map(|file| format!("{} ({} frames)", file.person.as_deref().unwrap_or("?"), file.frames()))
        .collect();
    let more = if names.len() > LISTED { ", …" } else { "" };
    let listed = names[..names.len().min(LISTED)].join(", ");
    Err(Error::format(
        path,
        format!("{} people: {listed}{more}: choose one by its name (--person)", names.len()),
    ))
}

/// Reads the motions of all people of a file or a directory of frames, or of the one that `options` names.
///
/// # Errors
/// If the file cannot be read or holds no poses, or has no person of that name.
pub fn read_motions(path: impl AsRef<Path>, options: &MotionOptions) -> Result<Vec<MotionFile>> {
    let path = path.as_ref();
    let found = if path.is_dir() { people_of_frames(path)? } else { people_of(path)? };
    let several = found.len() > 1;
    let chosen: Vec<(String, Clip)> = match &options.person {
        None => found,
        Some(wanted) => {
            let names: Vec<String> = found.iter().map(|(name, _)| name.clone()).collect();
            let chosen: Vec<_> = found.into_iter().filter(|(name, _)| name == wanted).collect();
            if chosen.is_empty() {
                let known = if names.iter().any(|name| !name.is_empty()) {
                    format!("the file has {}", names.join(", "))
                } else {
                    "the file has one without a name".to_owned()
                };
                return Err(Error::format(path, format!("no person `{wanted}`: {known}")));
            }
            chosen
        }
    };
    Ok(chosen
        .into_iter()
        .map(|(name, clip)| file(path, several.then_some(name), clip, options))
        .collect())
}

fn people_of(path: &Path) -> Result<Vec<(String, Clip)>> {
    let content = Content::open(path)?;
    people(content.path(), &content.root()?)
}

/// People of a directory with a file for each frame, in natural order of the names.
fn people_of_frames(directory: &Path) -> Result<Vec<(String, Clip)>> {
    let files = list_files(directory, |path| {
        let extension = path.extension().and_then(|extension| extension.to_str());
        extension.is_some_and(|e| EXTENSIONS.contains(&e.to_ascii_lowercase().as_str()))
    })?;
    if files.is_empty() {
        let message =
            "a directory without files of poses (.json, .npz, .npy, .pkl), one for each frame";
        return Err(Error::format(directory, message));
    }
    let mut frames = Vec::with_capacity(files.len());
    for path in &files {
        let people = people_of(path)?;
        if files.len() > 1
            && let Some((_, clip)) = people.iter().find(|(_, clip)| clip.frames() > 1)
        {
            let message = format!(
                "{} poses, expected one in each file of a directory: name the file itself",
                clip.frames()
            );
            return Err(Error::format(path, message));
        }
        frames.push(people);
    }
    Ok(joined_frames(frames))
}

fn file(path: &Path, person: Option<String>, clip: Clip, options: &MotionOptions) -> MotionFile {
    let mut notes = clip.notes;
    let (up, reason) = up_axis(&clip.poses, clip.amass, options.up);
    notes.extend(reason);
    if clip.frame_rate.is_none() && clip.poses.nrows() > 1 {
        notes.push(format!("no frame rate in the file: {DEFAULT_FRAME_RATE} frames per second"));
    }
    if clip.shapes > 1 {
        notes.push(format!("betas in {} rows: their mean is used", clip.shapes));
    }
    if !clip.left_out.is_empty() {
        let parts: Vec<String> =
            clip.left_out.iter().map(|(what, count)| format!("{count} {what}")).collect();
        notes.push(format!("left out, as SMPL has them not: {}", parts.join(", ")));
    }
    MotionFile {
        path: path.to_owned(),
        person,
        poses: clip.poses,
        translations: clip.translations,
        betas: clip.betas,
        gender: clip.gender,
        frame_rate: clip.frame_rate,
        joints: clip.joints,
        up,
        pivot: clip.pivot,
        offsets: clip.offsets,
        notes,
    }
}

/// The axis that points up, and a remark if it was guessed.
fn up_axis(poses: &Array2<f64>, amass: bool, given: Option<UpAxis>) -> (UpAxis, Option<String>) {
    if let Some(up) = given {
        return (up, None);
    }
    let (standing, cosine) = UpAxis::standing(poses.view());
    let remark = "if that is wrong, name the axis (--up)";
    if amass {
        if standing == UpAxis::Y && cosine > PLAINLY_STANDING {
            let note = format!(
                "z points up in AMASS's files, but the body of this one stands along y: y taken as up; {remark}"
            );
            return (UpAxis::Y, Some(note));
        }
        return (UpAxis::Z, None);
    }
    if cosine < STANDING {
        let note = format!("the posture does not tell which axis points up: y taken; {remark}");
        return (UpAxis::Y, Some(note));
    }
    let note = (standing != UpAxis::Y)
        .then(|| format!("{standing} taken as up, along which the body stands; {remark}"));
    (standing, note)
}
