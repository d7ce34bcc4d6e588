//! Poses and motions given on the command line.

use cape_core::{
    SmplModel,
    motion::{DEFAULT_FRAME_RATE, MotionFile, MotionOptions, UpAxis},
};
use cape_synth::poses::{load_motion, load_poses};
use clap::Args;

use crate::{console::Console, error::Result, options::ShapeArgs};

/// Choices in reading a file of poses.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct MotionFileArgs {
    /// Axis that points up in a file of poses: y, z or -y; auto finds it out.
    #[arg(long, default_value = "auto", allow_hyphen_values = true, value_name = "AXIS", value_parser = up_choice)]
    up: UpChoice,
    /// Person of a file of poses with several.
    #[arg(long, value_name = "NAME")]
    person: Option<String>,
}

/// Axis that points up, or none to find it out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct UpChoice(Option<UpAxis>);

fn up_choice(text: &str) -> Result<UpChoice, String> {
    if text == "auto" {
        return Ok(UpChoice(None));
    }
    let axis = text.parse().map_err(|_| "expected y, z, -y or auto".to_owned())?;
    Ok(UpChoice(Some(axis)))
}

impl MotionFileArgs {
    pub(crate) fn options(&self) -> MotionOptions {
        MotionOptions { person: self.person.clone(), up: self.up.0 }
    }

    /// A pose by name, or the poses of a file, whose shape is not used.
    pub(crate) fn poses(&self, text: &str, console: Console) -> Result<MotionFile> {
        let file = load_poses(text, &self.options())?;
        remark(&file, console);
        if file.betas.iter().any(|&beta| beta != 0.0) {
            console.note(&format!(
                "{}: the shape of the file is left out: give it by --betas where there is that option",
                file.path.display()
            ));
        }
        Ok(file)
    }

    /// A synthetic motion by name, of `seconds` at `frame_rate` frames per second (`other` if none is
    /// given), or that of a file.
    pub(crate) fn motion(
        &self,
        text: &str,
        seconds: f64,
        [frame_rate, other]: [Option<f64>; 2],
        console: Console,
    ) -> Result<MotionFile> {
        let rate = frame_rate.or(other).unwrap_or(DEFAULT_FRAME_RATE);
        let mut file = load_motion(text, seconds, rate, &self.options())?;
        if file.frame_rate.is_none() {
            // The option names the rate of a file that says none, and nothing is resampled.
            file.frame_rate = frame_rate;
        }
        if frame_rate.is_some() {
            file.notes.retain(|note| !note.starts_with("no frame rate"));
        }
        remark(&file, console);
        Ok(file)
    }
}

fn remark(file: &MotionFile, console: Console) {
    for note in &file.notes {
        console.note(&format!("{}: {note}", file.path.display()));
    }
}

/// Shape coefficients of a body that performs a motion: the given ones, or those of the file as far as
/// the body has them. Says what of the file is not used.
pub(crate) fn shape_of(
    file: &MotionFile,
    given: &ShapeArgs,
    body: &SmplModel,
    console: Console,
) -> Result<Vec<f32>> {
    let path = file.path.display();
    if let Some(gender) = &file.gender {
        console
            .note(&format!("{path}: gender `{gender}`: the body is the one that is chosen here"));
    }
    if given.given().is_some() {
        return given.betas(body);
    }
    let used = file.betas_for(body.betas());
    if used.len() < file.betas.len() {
        console.note(&format!(
            "{path}: the first {} of {} betas are used, as the body has no more",
            used.len(),
            file.betas.len()
        ));
    }
    Ok(used.iter().map(|&beta| beta as f32).collect())
}
