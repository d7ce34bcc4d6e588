//! Parameters of EasyMocap and of data sets made with it, such as ZJU-MoCap: the orientation `Rh` turns
//! the body about the origin, and the pose has none of its own.

use std::path::Path;

use ndarray::{Array2, s};

use super::{
    Pivot,
    clip::{Clip, SHARED},
    names::{Fields, numbers},
    rotations::{RotationLayout, people_and_frames},
};
use crate::{Error, Result};

/// Numbers of a pose, the orientation's zeros included: SMPL, SMPL+H and SMPL-X with components of the
/// hands, and with their joints.
const WIDTHS: [usize; 5] = [72, 78, 87, 156, 165];

/// True for a dictionary with `Rh` and `poses`.
pub(super) fn is_it(fields: &Fields) -> bool {
    numbers(fields, &["rh"]).is_some() && numbers(fields, &["poses"]).is_some()
}

/// The clip of a dictionary for which [`is_it`] holds.
pub(super) fn clips(path: &Path, fields: &Fields) -> Result<Vec<Clip>> {
    let (Some(turns), Some(poses)) = (numbers(fields, &["rh"]), numbers(fields, &["poses"])) else {
        return Ok(Vec::new());
    };
    let fault = |message: String| Error::field(path, "poses", message);
    let shape = &poses.numbers.shape;
    let known = shape.split_last().and_then(|(&width, lead)| {
        // Without the orientation's zeros.
        let start = usize::from(width == 69) * 3;
        let frames = people_and_frames(lead).filter(|(people, _)| *people == 1)?.1;
        WIDTHS.contains(&(width + start)).then_some((width, start, frames))
    });
    let (width, start, frames) = known.ok_or_else(|| {
        fault(format!("shape {shape:?}, expected [n, 69], [n, 72], [n, 78] or [n, 87] beside `Rh`"))
    })?;
    let used = if width + start == 72 { 72 } else { SHARED };
    let rows =
        Array2::from_shape_vec((frames, width), poses.numbers.read()?.iter().copied().collect())
            .map_err(|error| fault(error.to_string()))?;
    let mut pose = Array2::zeros((frames, used));
    pose.slice_mut(s![.., start..]).assign(&rows.slice(s![.., ..used - start]));
    if start == 0 && pose.slice(s![.., ..3]).iter().any(|angle| angle.abs() > 1e-6) {
        return Err(fault(
            "an orientation of its own beside `Rh`: expected zeros in the first three numbers"
                .into(),
        ));
    }
    let turned = turns.numbers.read()?;
    let layout = RotationLayout::of_root(&turned).filter(|l| (l.people, l.frames) == (1, frames));
    let layout = layout.ok_or_else(|| {
        let message =
            format!("shape {:?}, expected [{frames}, 3] as there are poses", turned.shape());
        Error::field(path, "Rh", message)
    })?;
    let turned = layout.axis_angles(&turned, 0).map_err(|e| Error::field(path, "Rh", e))?;
    pose.slice_mut(s![.., ..3]).assign(&turned);
    let mut clip = Clip::new(used / 3, pose).map_err(fault)?;
    clip.pivot = Pivot::Origin;
    if width > 72 {
        clip.left_out.push(("numbers of hands and face", width - SHARED));
    }
    Ok(vec![clip])
}
