//! Clips of the people whose arrays a dictionary has by name.

use std::path::Path;

use ndarray::{Array2, Axis, s};

use super::{
    Pivot,
    clip::{Clip, rows},
    content::{Entry, Numbers},
    easymocap,
    layout::{BODY_JOINTS, JOINTS, Wide},
    names::{BODIES, Common, Fields, IMAGE_ROWS, Named, PEOPLE_ROWS, POSES, ROOTS, find, numbers},
    person::PersonReader,
    rotations::{RotationLayout, people_and_frames},
};
use crate::{Error, Result};

/// True if a dictionary has rotations of a body.
pub(super) fn has_pose(fields: &Fields) -> bool {
    easymocap::is_it(fields) || pose_of(fields).is_some() || body_of(fields).is_some()
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

/// Clips of the people of a dictionary that [`has_pose`].
pub(super) fn clips(path: &Path, fields: &Fields, common: &Common) -> Result<Vec<Clip>> {
    let common = common.within(fields)?.with_inner_rate(fields)?;
    let mut clips = match (pose_of(fields), body_of(fields)) {
        _ if easymocap::is_it(fields) => easymocap::clips(path, fields)?,
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
    if let Some(images) = IMAGE_ROWS.into_iter().find(|name| find(fields, name).is_some()) {
        for clip in clips.iter_mut().filter(|clip| clip.frames() > 1) {
            clip.notes.push(format!(
                "its rows belong to images (`{images}`): they may be of several people and not follow \
                 each other"
            ));
        }
    }
    if let Some(offsets) = numbers(fields, &["vertexoffsets"])
        && let [_, 3] = offsets.numbers.shape[..]
    {
        let array = offsets.numbers.read()?;
        clips[0].offsets = array.into_dimensionality().ok();
    }
    let has = |name| find(fields, name).is_some();
    let amass = (has("mocap_framerate") && (has("dmpls") || clips[0].joints == 52))
        || (has("mocap_frame_rate") && (has("surface_model_type") || has("dmpls")));
    // CLOTH3D's info.mat: the translation is the place of the pelvis.
    let cloth3d = has("outfit") && has("zrot");
    for clip in &mut clips {
        clip.amass = amass;
        if cloth3d {
            clip.pivot = Pivot::PelvisAtOrigin;
        }
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
