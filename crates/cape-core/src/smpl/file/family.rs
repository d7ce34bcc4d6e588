//! Detection of STAR, SMPL-H, SMPL-X, FLAME and MANO files, which get an error of their own.

use std::path::Path;

use super::source::Source;
use crate::{Error, Result};

const EXPECTED: &str = "expected SMPL's own body of 24 joints \
                      (`SMPL_MALE.pkl`, `basicmodel_m_lbs_10_207_0_v1.0.0.pkl` or the like)";

fn refuse(path: &Path, family: &str) -> Error {
    Error::format(path, format!("is a {family} body, {EXPECTED}"))
}

/// Rejects other model families by arrays that SMPL does not have.
pub(super) fn refuse_others(source: &Source) -> Result<()> {
    let has = |name| source.contains(name);
    let family = if has("lmk_faces_idx") || has("expr_dirs") || has("lmk_bary_coords") {
        "SMPL-X or FLAME"
    } else if has("hands_componentsl") || has("hands_meanl") {
        "SMPL-H or SMPL-X"
    } else if has("hands_components") || has("hands_mean") {
        "MANO (hand)"
    } else {
        return Ok(());
    };
    Err(refuse(source.path(), family))
}

/// Rejects STAR by its pose directions, which depend on quaternions: 4 numbers for each joint but the
/// root, and the second shape coefficient.
pub(super) fn refuse_star(path: &Path, columns: usize, joints: usize) -> Result<()> {
    if columns == 4 * joints.saturating_sub(1) + 1 {
        return Err(refuse(path, "STAR"));
    }
    Ok(())
}

/// Rejects other model families by their number of joints.
pub(super) fn refuse_joints(path: &Path, joints: usize) -> Result<()> {
    match joints {
        16 => Err(refuse(path, "MANO (hand)")),
        5 => Err(refuse(path, "FLAME (head)")),
        52 => Err(refuse(path, "SMPL-H")),
        55 => Err(refuse(path, "SMPL-X")),
        _ => Ok(()),
    }
}
