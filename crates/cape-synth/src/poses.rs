//! Poses and motions by name, or from a file of any format of [`cape_core::motion`].

use std::path::Path;

use crate::{Error, Motion, MotionStyle, Result};
use cape_core::{
    BodyMotion, BodyPose,
    motion::{MotionFile, MotionOptions, read_motion},
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

/// A pose by its name (`t-pose`, `a-pose`, `walk` or a motion), or all poses of a file.
///
/// # Errors
/// If the name is unknown, or the file cannot be read as a motion.
pub fn load_poses(text: &str, options: &MotionOptions) -> Result<MotionFile> {
    if let Some(pose) = preset(text) {
        let motion = BodyMotion::from_poses(1.0, &[pose])?;
        return Ok(MotionFile::from_motion(text, motion));
    }
    load_file(text, "pose", options)
}

/// A motion by its name, `seconds` long at `frame_rate` frames per second, or that of a file, at the
/// file's own rate.
///
/// # Errors
/// See [`load_poses`].
pub fn load_motion(
    text: &str,
    seconds: f64,
    frame_rate: f64,
    options: &MotionOptions,
) -> Result<MotionFile> {
    let name = if text == "walk" { Motion::WalkMarch.name() } else { text };
    if let Some(motion) = Motion::ALL.into_iter().find(|motion| motion.name() == name) {
        let frames = (seconds * frame_rate).round().max(1.0) as usize;
        let style = MotionStyle::default();
        let at = |frame: usize| motion.pose(&style, frame as f64 / frame_rate);
        let poses: Vec<BodyPose> =
            (0..frames).map(|frame| at(frame).map(|angle| angle as f32)).collect();
        return Ok(MotionFile::from_motion(text, BodyMotion::from_poses(frame_rate, &poses)?));
    }
    if preset(text).is_some() {
        return load_poses(text, options);
    }
    load_file(text, "motion", options)
}

fn load_file(text: &str, kind: &str, options: &MotionOptions) -> Result<MotionFile> {
    let path = Path::new(text);
    if path.extension().is_none() && !path.exists() {
        let names: Vec<&str> = Motion::ALL.iter().map(|motion| motion.name()).collect();
        return Err(Error::Argument(format!(
            "unknown {kind} `{text}`: expected t-pose, a-pose, walk, {}, or a file (.npz, .npy, .pkl, \
             .json, .smpl or .csv)",
            names.join(", ")
        )));
    }
    read_motion(path, options)
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

#[cfg(test)]
mod tests {
    use cape_core::npy::write_npy;
    use ndarray::Array2;

    use super::*;

    fn load(text: &str) -> Result<MotionFile> {
        load_poses(text, &MotionOptions::default())
    }

    #[test]
    fn presets_have_names() {
        let pose = |name: &str| load(name).unwrap().upright_poses().unwrap()[0];
        assert_eq!(pose("t-pose"), [0.0; 72]);
        assert_ne!(pose("walk"), [0.0; 72]);
        assert_eq!(pose("walk"), pose("walk_march"));
        assert_eq!(load("walk").unwrap().pose_name(0), "walk");
        let message = load("headstand").unwrap_err().to_string();
        assert!(message.contains("headstand") && message.contains("a-pose"), "{message}");
    }

    #[test]
    fn motions_are_of_a_name_or_a_file() {
        let options = MotionOptions::default();
        let squats = load_motion("squats", 2.0, 15.0, &options).unwrap();
        assert_eq!((squats.frames(), squats.frame_rate), (30, Some(15.0)));
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("dance.npy");
        write_npy(&path, &Array2::from_elem((2, 72), 0.25)).unwrap();
        let dance = load_motion(&path.to_string_lossy(), 2.0, 15.0, &options).unwrap();
        assert_eq!((dance.frames(), dance.pose_name(1)), (2, "dance 1".to_owned()));
        assert!(load(&directory.path().join("none.npy").to_string_lossy()).is_err());
    }
}
