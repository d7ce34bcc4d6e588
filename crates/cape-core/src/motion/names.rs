//! Names of arrays that are in use, and values by them.

use super::content::{Entry, Numbers};
use crate::Result;

/// Names of all rotations of a body together. Of several that are there the first is read: `full_pose`
/// beside `smpl_poses` has positions of joints (EDGE).
pub(super) const POSES: [&str; 21] = [
    "pose_world",
    "poses",
    "pose",
    "smpl_poses",
    "fullpose",
    "full_pose",
    "full_poses",
    "pose_aa",
    "smpl_thetas",
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
pub(super) const ROOTS: [&str; 7] = [
    "poses_root_world",
    "global_orient",
    "root_orient",
    "poses_root",
    "root_pose",
    "smpl_global_orient",
    "poses_root_cam",
];
pub(super) const BODIES: [&str; 5] =
    ["body_pose", "pose_body", "poses_body", "smpl_body_pose", "local_pose"];
pub(super) const TRANSLATIONS: [&str; 14] = [
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
    // EasyMocap.
    "th",
];
pub(super) const BETAS: [&str; 9] = [
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
pub(super) const PEOPLE_ROWS: [&str; 4] = ["center_preds", "center_confs", "pj2d_org", "cam_trans"];
/// Arrays that tell that rows belong to images.
pub(super) const IMAGE_ROWS: [&str; 4] = ["imgname", "imgnames", "img_name", "image_name"];
/// Arrays of what SMPL's body has not, with their name in notes and numbers for each of it.
pub(super) const LEFT_OUT: [(&str, &str, usize); 17] = [
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
/// Values that hold for all people of a file.
#[derive(Debug, Clone, Default)]
pub(super) struct Common {
    pub(super) frame_rate: Option<f64>,
    pub(super) gender: Option<String>,
}

/// Entries of a dictionary.
pub(super) type Fields<'a> = [(String, Entry<'a>)];

pub(super) fn find<'e, 'a>(fields: &'e Fields<'a>, name: &str) -> Option<&'e Entry<'a>> {
    let named = |found: &str| found.to_ascii_lowercase().replace('-', "_") == name;
    fields.iter().find(|(found, _)| named(found)).map(|(_, entry)| entry)
}

pub(super) fn numbers<'e, 'a>(
    fields: &'e Fields<'a>,
    names: &[&'static str],
) -> Option<Named<'e, 'a>> {
    names.iter().find_map(|&name| match find(fields, name)? {
        Entry::Numbers(numbers) => Some(Named { name, numbers }),
        _ => None,
    })
}

/// An array with its name.
pub(super) struct Named<'e, 'a> {
    pub(super) name: &'static str,
    pub(super) numbers: &'e Numbers<'a>,
}

impl Common {
    /// These values, or those of a dictionary's own.
    pub(super) fn within(&self, fields: &Fields) -> Result<Self> {
        let mut common = self.clone();
        if let Some(rate) = frame_rate(fields)? {
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

    /// These values with the frame rate of a dictionary inside of `fields`, such as MoSh's details of
    /// a fit, if there is none yet.
    pub(super) fn with_inner_rate(mut self, fields: &Fields) -> Result<Self> {
        for (_, entry) in fields {
            if self.frame_rate.is_none()
                && let Entry::Map(inner) = entry
            {
                self.frame_rate = frame_rate(inner)?;
            }
        }
        Ok(self)
    }
}

/// Frames per second, if a dictionary says it.
fn frame_rate(fields: &Fields) -> Result<Option<f64>> {
    for name in RATES {
        let rate = match find(fields, name) {
            Some(Entry::Numbers(numbers)) => numbers.read()?.iter().next().copied(),
            Some(Entry::Text(text)) => text.trim_matches(['\'', '"', ' ']).parse().ok(),
            _ => None,
        };
        let rate = rate.filter(|rate: &f64| rate.is_finite() && *rate > 0.0);
        if rate.is_some() {
            return Ok(rate);
        }
    }
    Ok(None)
}

/// `male`, `female` or `neutral` of its spellings, such as `b'male'` and `m`.
fn gender(text: &str) -> Option<String> {
    let text = text.trim_start_matches("b'").trim_matches(['\'', '"', ' ']).to_lowercase();
    let known = ["male", "female", "neutral"];
    let found = known.into_iter().find(|name| *name == text || name[..1] == text);
    found.map(str::to_owned)
}
