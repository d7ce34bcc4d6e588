//! Poses by name, or from a file of SMPL, SMPL+H (AMASS) or SMPL-X poses.

use std::path::Path;

use ndarray::ArrayD;

use crate::{Error, Motion, MotionStyle, Result};
use cape_core::{
    BodyPose,
    npy::{Npz, expect_shape, read_f64},
};

/// Offsets of the axis-angles of the shoulders (joints 16 and 17) in a pose.
const SHOULDERS: [usize; 2] = [3 * 16, 3 * 17];
/// Angle of the arms below the horizontal in the pose `a-pose`, radians (about 46°).
///
/// This is the pose of pictures and synthetic captures; stored results contain its value. The A-pose
/// in which clothing offsets are measured, [`StandardPose::A`](cape_core::smpl::StandardPose), is
/// lowered by exactly 45°.
const CAPTURE_A_POSE_ANGLE: f32 = 0.8;
/// Time at which [`preset`] samples a motion, seconds.
const SAMPLE_TIME: f64 = 0.45;

/// Named poses: one by its name (`t-pose`, `a-pose`, `walk` or a motion), or all poses of a `.npy`,
/// `.npz` (array `poses` or `pose`) or `.csv` file.
///
/// # Errors
/// If the name is unknown, or the file does not hold rows of 72, 156 or 165 finite numbers.
pub fn poses(text: &str) -> Result<Vec<(String, BodyPose)>> {
    if let Some(pose) = preset(text) {
        return Ok(vec![(text.to_owned(), pose)]);
    }
    let path = Path::new(text);
    let (field, array) = if has_extension(path, "npz") {
        from_archive(path)?
    } else if has_extension(path, "npy") {
        ("poses", read_f64(path)?)
    } else if has_extension(path, "csv") {
        ("rows", from_csv(path)?)
    } else {
        let names: Vec<&str> = Motion::ALL.iter().map(|motion| motion.name()).collect();
        return Err(Error::Argument(format!(
            "unknown pose `{text}`: expected t-pose, a-pose, walk, {}, or a file (.npy, .npz or .csv)",
            names.join(", ")
        )));
    };
    numbers(path, field, &array)
}

/// Poses of a named motion for `seconds` at `frames_per_second`, or all poses of a file.
///
/// # Errors
/// See [`poses`].
pub fn motion_poses(text: &str, seconds: f64, frames_per_second: f64) -> Result<Vec<BodyPose>> {
    let name = if text == "walk" { Motion::WalkMarch.name() } else { text };
    if let Some(motion) = Motion::ALL.into_iter().find(|motion| motion.name() == name) {
        let frames = (seconds * frames_per_second).round().max(1.0) as usize;
        let style = MotionStyle::default();
        let at = |frame: usize| motion.pose(&style, frame as f64 / frames_per_second);
        return Ok((0..frames).map(|frame| at(frame).map(|angle| angle as f32)).collect());
    }
    Ok(poses(text)?.into_iter().map(|(_, pose)| pose).collect())
}

/// Pose called `name`: `t-pose`, `a-pose`, or a sample of a motion.
pub fn preset(name: &str) -> Option<BodyPose> {
    match name {
        "t-pose" => return Some([0.0; 72]),
        "a-pose" => {
            let mut pose = [0.0; 72];
            // A negative rotation about z lowers the left arm (+x).
            pose[SHOULDERS[0] + 2] = -CAPTURE_A_POSE_ANGLE;
            pose[SHOULDERS[1] + 2] = CAPTURE_A_POSE_ANGLE;
            return Some(pose);
        }
        _ => {}
    }
    let name = if name == "walk" { Motion::WalkMarch.name() } else { name };
    let motion = Motion::ALL.into_iter().find(|motion| motion.name() == name)?;
    Some(motion.pose(&MotionStyle::default(), SAMPLE_TIME).map(|angle| angle as f32))
}

fn has_extension(path: &Path, expected: &str) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(expected))
}

fn from_archive(path: &Path) -> Result<(&'static str, ArrayD<f64>)> {
    let mut archive = Npz::open(path)?;
    let field = if archive.contains("poses") { "poses" } else { "pose" };
    Ok((field, archive.f64(field)?))
}

/// Reads rows of numbers; a first row of names is skipped.
fn from_csv(path: &Path) -> Result<ArrayD<f64>> {
    let text = std::fs::read_to_string(path).map_err(|error| Error::io(path, error))?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let (mut rows, mut width, mut values) = (0, 0, Vec::new());
    for (index, line) in lines {
        let cells: Result<Vec<f64>, _> = line.split(',').map(|cell| cell.trim().parse()).collect();
        let row = match cells {
            Ok(row) => row,
            Err(_) if rows == 0 => continue,
            Err(_) => {
                let message = format!("line {}: expected comma-separated numbers", index + 1);
                return Err(Error::format(path, message));
            }
        };
        if rows > 0 && row.len() != width {
            let message = format!("line {}: {} numbers, expected {width}", index + 1, row.len());
            return Err(Error::format(path, message));
        }
        (rows, width) = (rows + 1, row.len());
        values.extend(row);
    }
    ArrayD::from_shape_vec(vec![rows, width], values)
        .map_err(|error| Error::Argument(format!("{}: {error}", path.display())))
}

/// Numbers per pose in files of SMPL, SMPL+H (AMASS) and SMPL-X. The first 22 joints are the same in
/// all three; hand poses of the latter two are ignored.
const WIDTHS: [usize; 3] = [72, 156, 165];
/// Numbers of the 22 joints that the three models share.
const SHARED: usize = 66;

fn numbers(path: &Path, field: &str, array: &ArrayD<f64>) -> Result<Vec<(String, BodyPose)>> {
    let width = array.shape().last().copied().filter(|width| WIDTHS.contains(width));
    let width = width.unwrap_or(WIDTHS[0]);
    if array.ndim() == 1 {
        expect_shape(path, field, array.shape(), &[Some(width)])?;
    } else {
        expect_shape(path, field, array.shape(), &[None, Some(width)])?;
    }
    if let Some(at) = array.iter().position(|angle| !angle.is_finite()) {
        let message = format!("number {at} is not finite");
        return Err(Error::field(path, field, message));
    }
    if array.is_empty() {
        return Err(Error::field(path, field, "holds no pose"));
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let angles: Vec<f32> = array.iter().map(|&angle| angle as f32).collect();
    let poses: Vec<BodyPose> = angles
        .chunks(width)
        .map(|row| {
            let used = if width == 72 { 72 } else { SHARED };
            let mut pose: BodyPose = [0.0; 72];
            pose[..used].copy_from_slice(&row[..used]);
            pose
        })
        .collect();
    let name = |index| if poses.len() == 1 { stem.clone() } else { format!("{stem} {index}") };
    Ok(poses.iter().enumerate().map(|(index, &pose)| (name(index), pose)).collect())
}

#[cfg(test)]
mod tests {
    use cape_core::npy::{NpzWriter, write_npy};
    use ndarray::{Array1, Array2};

    use super::*;

    #[test]
    fn presets_have_names() {
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
        let mut amass = Array2::from_elem((2, 156), 0.5);
        amass[[1, 66]] = 9.0;
        write_npy(&path, &amass).unwrap();
        let pose = load(&path).unwrap()[1].1;
        assert_eq!((pose[65], pose[66]), (0.5, 0.0));

        let path = directory.path().join("table.csv");
        let row = vec!["0.5"; 72].join(",");
        std::fs::write(&path, format!("{}\n{row}\n\n{row}\n", vec!["a"; 72].join(","))).unwrap();
        assert_eq!(load(&path).unwrap().len(), 2);
        std::fs::write(&path, format!("{row}\n{row},1\n")).unwrap();
        assert!(load(&path).unwrap_err().to_string().contains("line 2"));
        std::fs::write(&path, format!("{row}\n0.5,x\n")).unwrap();
        assert!(load(&path).unwrap_err().to_string().contains("line 2"));

        let path = directory.path().join("frame.npz");
        let mut archive = NpzWriter::create(&path).unwrap();
        archive.add("pose", &Array1::from_elem(72, 0.5)).unwrap();
        archive.finish().unwrap();
        assert_eq!(load(&path).unwrap()[0].1, [0.5; 72]);
    }
}
