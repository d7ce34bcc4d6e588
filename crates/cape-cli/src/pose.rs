//! Poses by name or from a file.

use std::path::Path;

use cape_core::{
    npy::{Npz, expect_shape, read_f64},
    synth::{Motion, MotionStyle},
};
use ndarray::ArrayD;

use crate::{
    error::{Error, Result},
    mesh_file::has_extension,
};

/// 24 axis-angles, radians.
pub(crate) type Pose = [f32; 72];

/// Joints 16 and 17, the shoulders: where their axis-angles begin.
const SHOULDERS: [usize; 2] = [3 * 16, 3 * 17];
/// How far the arms hang below the horizontal in an A-pose, radians.
const A_POSE: f32 = 0.8;
/// The instant at which movements are caught, seconds.
const INSTANT: f64 = 0.45;

/// One pose, or all poses of a file, with a name for each.
pub(crate) fn poses(text: &str) -> Result<Vec<(String, Pose)>> {
    if let Some(pose) = preset(text) {
        return Ok(vec![(text.to_owned(), pose)]);
    }
    let path = Path::new(text);
    let (field, array) = if has_extension(path, "npz") {
        from_archive(path)?
    } else if has_extension(path, "npy") {
        ("poses", read_f64(path)?)
    } else {
        let names: Vec<&str> = Motion::ALL.iter().map(|motion| motion.name()).collect();
        return Err(Error::message(format!(
            "unknown pose `{text}`: expected t-pose, a-pose, walk, {}, or a file (.npy or .npz)",
            names.join(", ")
        )));
    };
    numbers(path, field, &array)
}

/// The pose of that name.
pub(crate) fn preset(name: &str) -> Option<Pose> {
    match name {
        "t-pose" => return Some([0.0; 72]),
        "a-pose" => {
            let mut pose = [0.0; 72];
            // Turning about z lowers the left arm (+x) by a negative angle.
            pose[SHOULDERS[0] + 2] = -A_POSE;
            pose[SHOULDERS[1] + 2] = A_POSE;
            return Some(pose);
        }
        _ => {}
    }
    let name = if name == "walk" { Motion::WalkMarch.name() } else { name };
    let motion = Motion::ALL.into_iter().find(|motion| motion.name() == name)?;
    Some(motion.pose(&MotionStyle::default(), INSTANT).map(|angle| angle as f32))
}

fn from_archive(path: &Path) -> Result<(&'static str, ArrayD<f64>)> {
    let mut archive = Npz::open(path)?;
    let field = if archive.contains("poses") { "poses" } else { "pose" };
    Ok((field, archive.f64(field)?))
}

fn numbers(path: &Path, field: &str, array: &ArrayD<f64>) -> Result<Vec<(String, Pose)>> {
    if array.ndim() == 1 {
        expect_shape(path, field, array.shape(), &[Some(72)])?;
    } else {
        expect_shape(path, field, array.shape(), &[None, Some(72)])?;
    }
    if let Some(at) = array.iter().position(|angle| !angle.is_finite()) {
        let message = format!("number {at} is not finite");
        return Err(cape_core::Error::field(path, field, message).into());
    }
    if array.is_empty() {
        return Err(cape_core::Error::field(path, field, "there is no pose").into());
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let angles: Vec<f32> = array.iter().map(|&angle| angle as f32).collect();
    let (poses, _) = angles.as_chunks::<72>();
    let name = |index| if poses.len() == 1 { stem.clone() } else { format!("{stem} {index}") };
    Ok(poses.iter().enumerate().map(|(index, &pose)| (name(index), pose)).collect())
}

#[cfg(test)]
mod tests {
    use cape_core::npy::{NpzWriter, write_npy};
    use ndarray::{Array1, Array2};

    use super::*;

    #[test]
    fn presets_are_known_by_name() {
        assert_eq!(poses("t-pose").unwrap()[0].1, [0.0; 72]);
        assert_ne!(poses("walk").unwrap()[0].1, [0.0; 72]);
        assert_eq!(poses("walk").unwrap()[0].1, poses("walk_march").unwrap()[0].1);
        let message = poses("headstand").unwrap_err().to_string();
        assert!(message.contains("headstand") && message.contains("a-pose"), "{message}");
    }

    #[test]
    fn files_hold_one_pose_or_many() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("dance.npy");
        let load = |path: &Path| poses(&path.to_string_lossy());
        write_npy(&path, &Array1::from_elem(72, 0.5)).unwrap();
        assert_eq!(load(&path).unwrap(), [("dance".to_owned(), [0.5; 72])]);
        write_npy(&path, &Array2::from_elem((2, 72), 0.25)).unwrap();
        assert_eq!(load(&path).unwrap()[1], ("dance 1".to_owned(), [0.25; 72]));
        for wrong in [vec![3], vec![2, 71], vec![0, 72], vec![1, 2, 36]] {
            write_npy(&path, &ArrayD::from_elem(wrong, 0.25)).unwrap();
            assert!(load(&path).unwrap_err().to_string().contains("dance.npy"));
        }
        write_npy(&path, &Array1::from_elem(72, f64::NAN)).unwrap();
        assert!(load(&path).unwrap_err().to_string().contains("not finite"));
        let path = directory.path().join("frame.npz");
        let mut archive = NpzWriter::create(&path).unwrap();
        archive.add("pose", &Array1::from_elem(72, 0.5)).unwrap();
        archive.finish().unwrap();
        assert_eq!(load(&path).unwrap()[0].1, [0.5; 72]);
    }
}
