//! Arrays of a motion by the names that are in use.

use std::path::Path;

use ndarray::{Array2, ArrayD, Axis, s};

use super::{
    content::{Entry, Numbers},
    rotations::{RotationLayout, are_positions, people_and_frames},
};
use crate::{Error, Result};

/// Names of all rotations of a body together. Of several that are there the first is read.
const POSES: [&str; 21] = [
    "pose_world",
    "poses",
    "pose",
    "fullpose",
    "full_pose",
    "full_poses",
    "pose_aa",
    "smpl_thetas",
    "smpl_poses",
    "smpl_pose",
    "pose_est_fullposes",
    "pred_pose",
    "pred_rotmat",
    "pred_thetas",
    "rotmat",
    "global_pose",
    "theta",
    "thetas",
    "bodypose",
    "smpl",
    "motion",
];
const ROOTS: [&str; 7] = [
    "poses_root_world",
    "global_orient",
    "root_orient",
    "poses_root",
    "root_pose",
    "smpl_global_orient",
    "poses_root_cam",
];
const BODIES: [&str; 5] = ["body_pose", "pose_body", "poses_body", "smpl_body_pose", "local_pose"];
const TRANSLATIONS: [&str; 13] = [
    "trans_world",
    "trans",
    "transl",
    "translation",
    "smpl_trans",
    "smpl_transl",
    "trans_orig",
    "pose_est_trans",
    "root_translation",
    "pred_trans",
    "bodytranslation",
    "root_trans",
    "global_t",
];
const BETAS: [&str; 9] = [
    "betas",
    "beta",
    "shape",
    "shapes",
    "smpl_betas",
    "pred_shape",
    "pred_betas",
    "shape_est_betas",
    "shapeparameters",
];
const RATES: [&str; 6] =
    ["mocap_framerate", "mocap_frame_rate", "fps", "framerate", "frame_rate", "frame_rates"];
const GENDERS: [&str; 2] = ["gender", "genders"];
/// Arrays that tell that rows are people of one image.
const PEOPLE_ROWS: [&str; 4] = ["center_preds", "center_confs", "pj2d_org", "cam_trans"];
/// Arrays of what SMPL's body has not, with their name in notes and numbers for each of it.
const LEFT_OUT: [(&str, &str, usize); 17] = [
    ("left_hand_pose", "hand joints", 3),
    ("right_hand_pose", "hand joints", 3),
    ("lefthandpose", "hand joints", 3),
    ("righthandpose", "hand joints", 3),
    ("pose_lhand", "hand joints", 3),
    ("pose_rhand", "hand joints", 3),
    ("pose_hand", "hand joints", 3),
    ("jaw_pose", "joints of jaw and eyes", 3),
    ("leye_pose", "joints of jaw and eyes", 3),
    ("reye_pose", "joints of jaw and eyes", 3),
    ("pose_jaw", "joints of jaw and eyes", 3),
    ("pose_eye", "joints of jaw and eyes", 3),
    ("headpose", "joints of jaw and eyes", 3),
    ("expression", "expression coefficients", 1),
    ("expressions", "expression coefficients", 1),
    ("expressionparameters", "expression coefficients", 1),
    ("dmpls", "soft-tissue coefficients", 1),
];
/// Numbers of joints: SMPL, the body joints alone, SMPL+H, SMPL-X.
const JOINTS: [usize; 4] = [24, 22, 52, 55];
/// Numbers of joints without the root.
const BODY_JOINTS: [usize; 2] = [23, 21];
/// Numbers of the joints that all models share.
const SHARED: usize = 66;

/// Rotations, translations and shape of one person over frames.
#[derive(Debug, Clone, Default)]
pub(super) struct Clip {
    /// Axis-angles of SMPL's joints, radians, `[frames, 72]`.
    pub(super) poses: Array2<f64>,
    /// Metres, `[frames, 3]`.
    pub(super) translations: Option<Array2<f64>>,
    /// Mean over the frames.
    pub(super) betas: Vec<f64>,
    /// Number of rows that `betas` is the mean of.
    pub(super) shapes: usize,
    pub(super) gender: Option<String>,
    pub(super) frame_rate: Option<f64>,
    /// Number of joints of the file.
    pub(super) joints: usize,
    /// Numbers of things that the body has not, with their names.
    pub(super) left_out: Vec<(&'static str, usize)>,
    /// True for files of AMASS's layout, in which z points up.
    pub(super) amass: bool,
    /// Displacements of the rest vertices, metres, `[V, 3]`.
    pub(super) offsets: Option<Array2<f64>>,
    pub(super) notes: Vec<String>,
}

/// Values that hold for all people of a file.
#[derive(Debug, Clone, Default)]
pub(super) struct Common {
    frame_rate: Option<f64>,
    gender: Option<String>,
}

/// Entries of a dictionary.
pub(super) type Fields<'a> = [(String, Entry<'a>)];

fn find<'e, 'a>(fields: &'e Fields<'a>, name: &str) -> Option<&'e Entry<'a>> {
    let named = |found: &str| found.to_ascii_lowercase().replace('-', "_") == name;
    fields.iter().find(|(found, _)| named(found)).map(|(_, entry)| entry)
}

fn numbers<'e, 'a>(fields: &'e Fields<'a>, names: &[&'static str]) -> Option<Named<'e, 'a>> {
    names.iter().find_map(|&name| match find(fields, name)? {
        Entry::Numbers(numbers) => Some(Named { name, numbers }),
        _ => None,
    })
}

struct Named<'e, 'a> {
    name: &'static str,
    numbers: &'e Numbers<'a>,
}

impl Common {
    /// These values, or those of a dictionary's own.
    pub(super) fn within(&self, fields: &Fields) -> Result<Self> {
        let mut common = self.clone();
        if let Some(rate) = numbers(fields, &RATES)
            && let Some(&rate) = rate.numbers.read()?.iter().next()
            && rate.is_finite()
            && rate > 0.0
        {
            common.frame_rate = Some(rate);
        }
        for name in GENDERS {
            match find(fields, name) {
                Some(Entry::Text(text)) => common.gender = gender(text),
                Some(Entry::Numbers(numbers)) if numbers.shape.iter().all(|&n| n == 1) => {
                    // `.smpl`: neutral, male, female.
                    let names = ["neutral", "male", "female"];
                    let number = numbers.read()?.iter().next().copied().unwrap_or(f64::NAN);
                    let known = names.iter().enumerate().find(|(k, _)| *k as f64 == number);
                    common.gender = known.map(|(_, name)| (*name).to_owned());
                }
                _ => {}
            }
        }
        Ok(common)
    }
}

/// `male`, `female` or `neutral` of its spellings, such as `b'male'` and `m`.
fn gender(text: &str) -> Option<String> {
    let text = text.trim_start_matches("b'").trim_matches(['\'', '"', ' ']).to_lowercase();
    let known = ["male", "female", "neutral"];
    let found = known.into_iter().find(|name| *name == text || name[..1] == text);
    found.map(str::to_owned)
}

/// True if a dictionary has rotations of a body.
pub(super) fn has_pose(fields: &Fields) -> bool {
    pose_of(fields).is_some() || body_of(fields).is_some()
}

fn pose_of<'e, 'a>(fields: &'e Fields<'a>) -> Option<(Named<'e, 'a>, Wide)> {
    POSES.iter().chain(&BODIES).find_map(|&name| match find(fields, name)? {
        Entry::Numbers(numbers) => {
            // The global pose of W-HMR may be the root's alone, `body_pose` the rest.
            let wide = Wide::of(&numbers.shape, name)?;
            Some((Named { name, numbers }, wide))
        }
        _ => None,
    })
}

fn body_of<'e, 'a>(fields: &'e Fields<'a>) -> Option<(Named<'e, 'a>, RotationLayout)> {
    BODIES.iter().find_map(|&name| match find(fields, name)? {
        Entry::Numbers(numbers) => {
            let layout = RotationLayout::of(&numbers.shape, &BODY_JOINTS)?;
            Some((Named { name, numbers }, layout))
        }
        _ => None,
    })
}

/// Rows of rotations of all joints, alone or with other numbers.
#[derive(Debug, Clone, PartialEq)]
enum Wide {
    Rotations(RotationLayout),
    /// Joints, their columns, those of translation and shape.
    Columns(Columns),
    /// Joints, representation, frames, as motion diffusion models have them: `[24, 6, n]`.
    FramesLast(usize),
}

/// Columns of a table of poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Columns {
    width: usize,
    pose: [usize; 2],
    translation: Option<usize>,
    betas: Option<[usize; 2]>,
    name: &'static str,
}

/// Tables whose width tells their columns.
const TABLES: [Columns; 5] = [
    Columns {
        width: 75,
        pose: [0, 72],
        translation: Some(72),
        betas: None,
        name: "pose and translation",
    },
    Columns {
        width: 82,
        pose: [0, 72],
        translation: None,
        betas: Some([72, 82]),
        name: "pose and betas",
    },
    Columns {
        width: 85,
        pose: [3, 75],
        translation: None,
        betas: Some([75, 85]),
        name: "camera, pose and betas",
    },
    Columns {
        width: 159,
        pose: [0, 156],
        translation: Some(156),
        betas: None,
        name: "pose and translation",
    },
    Columns {
        width: 322,
        pose: [0, 156],
        translation: Some(309),
        betas: Some([312, 322]),
        name: "Motion-X",
    },
];

impl Wide {
    fn of(shape: &[usize], name: &str) -> Option<Self> {
        if let ("thetas" | "motion", &[24, 6, frames]) = (name, shape) {
            return Some(Self::FramesLast(frames));
        }
        if let Some(layout) = RotationLayout::of(shape, &JOINTS) {
            return Some(Self::Rotations(layout));
        }
        let (&width, lead) = shape.split_last()?;
        people_and_frames(lead)?;
        TABLES.into_iter().find(|table| table.width == width).map(Self::Columns)
    }
}

/// Clips of the people of a dictionary that [`has_pose`].
pub(super) fn clips(path: &Path, fields: &Fields, common: &Common) -> Result<Vec<Clip>> {
    let common = common.within(fields)?;
    let mut clips = match (pose_of(fields), body_of(fields)) {
        (Some((named, wide)), _) => wide_clips(path, &named, &wide)?,
        (None, Some((named, layout))) => split_clips(path, fields, &named, &layout)?,
        (None, None) => return Ok(Vec::new()),
    };
    let one = clips.len() == 1 && clips[0].poses.nrows() > 1;
    if one && PEOPLE_ROWS.iter().any(|name| find(fields, name).is_some()) {
        clips = rows(&clips[0]);
    }
    let people = clips.len();
    for (person, clip) in clips.iter_mut().enumerate() {
        clip.frame_rate = common.frame_rate;
        clip.gender.clone_from(&common.gender);
        let reader = PersonReader { path, fields, person, people };
        reader.translation(clip)?;
        reader.betas(clip)?;
        reader.left_out(clip);
    }
    if let Some(offsets) = numbers(fields, &["vertexoffsets"])
        && let [_, 3] = offsets.numbers.shape[..]
    {
        let array = offsets.numbers.read()?;
        clips[0].offsets = array.into_dimensionality().ok();
    }
    let rate = |name| find(fields, name).is_some();
    let amass = (rate("mocap_framerate") && (rate("dmpls") || clips[0].joints == 52))
        || (rate("mocap_frame_rate") && (rate("surface_model_type") || rate("dmpls")));
    for clip in &mut clips {
        clip.amass = amass;
    }
    Ok(clips)
}

/// Clips of an array without a name.
pub(super) fn unnamed_clips(path: &Path, numbers: &Numbers) -> Result<Option<Vec<Clip>>> {
    let Some(wide) = Wide::of(&numbers.shape, "") else { return Ok(None) };
    wide_clips(path, &Named { name: "array", numbers }, &wide).map(Some)
}

fn wide_clips(path: &Path, named: &Named, wide: &Wide) -> Result<Vec<Clip>> {
    let array = named.numbers.read()?;
    let fault = |message: String| Error::field(path, named.name, message);
    if are_positions(&array) {
        return Err(fault(format!(
            "{:?} are positions of joints, not rotations, as the distances between neighbours do not \
             change: fit SMPL to them and give its poses",
            array.shape()
        )));
    }
    match wide {
        Wide::Rotations(layout) => {
            let clip = |person| Clip::new(layout.joints, layout.axis_angles(&array, person)?);
            (0..layout.people).map(|person| clip(person).map_err(fault)).collect()
        }
        Wide::FramesLast(frames) => {
            let array = array.permuted_axes(vec![2, 0, 1]).as_standard_layout().into_owned();
            let layout = RotationLayout::of(&[*frames, 24, 6], &JOINTS)
                .ok_or_else(|| fault("unknown layout".into()))?;
            Ok(vec![Clip::new(24, layout.axis_angles(&array, 0).map_err(fault)?).map_err(fault)?])
        }
        Wide::Columns(table) => {
            let shape = array.shape().to_vec();
            let (people, frames) = people_and_frames(&shape[..shape.len() - 1])
                .ok_or_else(|| fault(format!("shape {shape:?}")))?;
            let rows = array
                .into_shape_with_order((people, frames, table.width))
                .map_err(|error| fault(error.to_string()))?;
            rows.outer_iter()
                .map(|rows| {
                    let [start, end] = table.pose;
                    let pose = rows.slice(s![.., start..end]).to_owned();
                    let mut clip = Clip::new((end - start) / 3, pose).map_err(fault)?;
                    if let Some(at) = table.translation {
                        clip.translations = Some(rows.slice(s![.., at..at + 3]).to_owned());
                    }
                    if let Some([start, end]) = table.betas {
                        let betas = rows.slice(s![.., start..end]);
                        clip.shapes = betas.nrows();
                        clip.betas =
                            betas.mean_axis(Axis(0)).map(|b| b.to_vec()).unwrap_or_default();
                    }
                    clip.notes.push(format!("{} columns read as {}", table.width, table.name));
                    Ok(clip)
                })
                .collect()
        }
    }
}

/// Clips of the root's rotation and the other joints' in arrays of their own.
fn split_clips(
    path: &Path,
    fields: &Fields,
    body: &Named,
    layout: &RotationLayout,
) -> Result<Vec<Clip>> {
    let fault = |message: String| Error::field(path, body.name, message);
    let rotations = body.numbers.read()?;
    let root = match numbers(fields, &ROOTS).or_else(|| numbers(fields, &["global_pose"])) {
        None => None,
        Some(named) => {
            let array = named.numbers.read()?;
            let shape = array.shape().to_vec();
            let root = RotationLayout::of_root(&array)
                .filter(|root| (root.people, root.frames) == (layout.people, layout.frames));
            let root = root.ok_or_else(|| {
                let message = format!(
                    "shape {shape:?}, but `{}` has {:?}: expected a rotation for each of its {} frames",
                    body.name, body.numbers.shape, layout.frames
                );
                Error::field(path, named.name, message)
            })?;
            Some((named.name, root, array))
        }
    };
    let mut clips = Vec::new();
    for person in 0..layout.people {
        let others = layout.axis_angles(&rotations, person).map_err(fault)?;
        let mut pose = Array2::zeros((layout.frames, others.ncols() + 3));
        pose.slice_mut(s![.., 3..]).assign(&others);
        if let Some((name, root, array)) = &root {
            let turns = root
                .axis_angles(array, person)
                .map_err(|message| Error::field(path, *name, message))?;
            pose.slice_mut(s![.., ..3]).assign(&turns);
        }
        let mut clip = Clip::new(layout.joints + 1, pose).map_err(fault)?;
        if root.is_none() {
            clip.notes.push("no orientation of the body in the file: it faces +z".into());
        }
        clips.push(clip);
    }
    Ok(clips)
}

impl Clip {
    /// A clip of axis-angles `[frames, 3 · joints]`.
    fn new(joints: usize, rotations: Array2<f64>) -> Result<Self, String> {
        if rotations.nrows() == 0 {
            return Err("holds no pose".into());
        }
        if let Some(at) = rotations.iter().position(|angle| !angle.is_finite()) {
            let (frame, number) = (at / rotations.ncols(), at % rotations.ncols());
            return Err(format!("number {number} of frame {frame} is not finite"));
        }
        let used = if joints == 24 { 72 } else { SHARED };
        let mut poses = Array2::zeros((rotations.nrows(), 72));
        poses.slice_mut(s![.., ..used]).assign(&rotations.slice(s![.., ..used]));
        let left_out = match joints {
            52 => vec![("hand joints", 30)],
            55 => vec![("joints of jaw and eyes", 3), ("hand joints", 30)],
            _ => Vec::new(),
        };
        Ok(Self { poses, joints, left_out, ..Self::default() })
    }

    pub(super) fn frames(&self) -> usize {
        self.poses.nrows()
    }
}

/// Each row of a clip as a person of one frame.
fn rows(clip: &Clip) -> Vec<Clip> {
    let row =
        |row: usize| Clip { poses: clip.poses.slice(s![row..=row, ..]).to_owned(), ..clip.clone() };
    (0..clip.frames()).map(row).collect()
}

/// Reader of what belongs to one of several people.
struct PersonReader<'e, 'a> {
    path: &'e Path,
    fields: &'e Fields<'a>,
    person: usize,
    people: usize,
}

impl PersonReader<'_, '_> {
    /// Rows `[frames or 1, columns]` of an array `[frames?, columns]`, of one with people first if
    /// there are several.
    fn rows(&self, array: &ArrayD<f64>, frames: usize) -> Option<Array2<f64>> {
        let (&columns, lead) = array.shape().split_last()?;
        let lead: Vec<usize> = match lead {
            [people, frames, 1] => vec![*people, *frames],
            _ => lead.to_vec(),
        };
        let own = match lead[..] {
            [people, rows] if people == self.people && (self.people > 1 || rows == frames) => rows,
            [rows, 1] if self.people == 1 => rows,
            [people] if self.people > 1 && people == self.people => 1,
            [rows] if self.people == 1 => rows,
            [] => 1,
            _ => return None,
        };
        let several = self.people > 1 && !lead.is_empty();
        let before = if several { self.person * own * columns } else { 0 };
        let numbers = array.iter().copied().skip(before).take(own * columns).collect();
        Array2::from_shape_vec((own, columns), numbers).ok()
    }

    fn translation(&self, clip: &mut Clip) -> Result<()> {
        let Some(named) = numbers(self.fields, &TRANSLATIONS) else { return Ok(()) };
        let fault = |message| Error::field(self.path, named.name, message);
        let mut array = named.numbers.read()?;
        let frames = clip.frames();
        if array.shape() == [3, frames] && frames != 3 {
            array = array.reversed_axes().as_standard_layout().into_owned();
        }
        let rows = self.rows(&array, frames).filter(|rows| rows.dim() == (frames, 3));
        let mut rows = rows.ok_or_else(|| {
            fault(format!("shape {:?}, expected [{frames}, 3] as there are poses", array.shape()))
        })?;
        if let Some(scale) = numbers(self.fields, &["smpl_scaling"])
            && let Some(&scale) = scale.numbers.read()?.iter().next()
        {
            if !(scale.is_finite() && scale > 0.0) {
                let message = format!("{scale}: expected a positive number");
                return Err(Error::field(self.path, "smpl_scaling", message));
            }
            // AIST++ scales the body; a body of SMPL's size moves by as much less.
            rows /= scale;
        }
        if let Some(at) = rows.iter().position(|x| !x.is_finite()) {
            return Err(fault(format!("number {} of frame {} is not finite", at % 3, at / 3)));
        }
        clip.translations = Some(rows);
        Ok(())
    }

    fn betas(&self, clip: &mut Clip) -> Result<()> {
        let Some(named) = numbers(self.fields, &BETAS) else { return Ok(()) };
        // `shape` may be another's, such as that of an image.
        if named.name.starts_with("shape") && named.numbers.shape.last().is_none_or(|&n| n < 8) {
            return Ok(());
        }
        let array = named.numbers.read()?;
        let Some(rows) = self.rows(&array, clip.frames()) else {
            clip.notes.push(format!("betas of shape {:?} are left out", array.shape()));
            return Ok(());
        };
        let mean = rows.mean_axis(Axis(0)).map(|mean| mean.to_vec()).unwrap_or_default();
        if mean.iter().any(|beta| !beta.is_finite()) {
            return Err(Error::field(self.path, named.name, "a coefficient is not finite"));
        }
        (clip.betas, clip.shapes) = (mean, rows.nrows());
        Ok(())
    }

    fn left_out(&self, clip: &mut Clip) {
        for (name, what, each) in LEFT_OUT {
            let Some(Entry::Numbers(numbers)) = find(self.fields, name) else { continue };
            let skip = usize::from(numbers.shape.len() > 1);
            let count: usize = numbers.shape.iter().skip(skip).product::<usize>() / each;
            let counted = clip.left_out.iter().any(|(known, _)| *known == what) && clip.joints > 24;
            if count > 0 && !counted {
                match clip.left_out.iter_mut().find(|(known, _)| *known == what) {
                    Some((_, total)) => *total += count,
                    None => clip.left_out.push((what, count)),
                }
            }
        }
    }
}
