//! Registrations given on the command line: captured clothing and the body that wears it.

use std::path::{Path, PathBuf};

use cape_core::{
    Outfit,
    motion::{MotionOptions, read_motion},
    npy::read_f64,
};
use cape_data::{Split, raw};
use cape_infer::{BodySpec, Run};
use cape_stats::errors::mean_distance_mm;
use clap::Args;
use ndarray::{Array2, Array3, Axis, Ix2};

use crate::{
    error::{Error, Result},
    mesh_file::has_extension,
};

/// Outfit and body of a registration, where the file does not tell them.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct KnownBodyArgs {
    /// Outfit of the registration [default: from the name of its directory].
    #[arg(long = "was", value_name = "OUTFIT")]
    pub(crate) outfit_worn: Option<Outfit>,
    /// Minimal body shape, .npy of [vertices, 3] [default: from the raw tree of the frame].
    #[arg(long, value_name = "FILE.npy")]
    pub(crate) minimal: Option<PathBuf>,
}

/// Registered clothing of a frame.
#[derive(Debug, Clone)]
pub(crate) struct RegistrationFile {
    /// Canonical displacements, `[1, vertices, 3]`, metres.
    pub(crate) displacement: Array3<f32>,
    pub(crate) wearer: BodySpec,
    /// Minimal body shape, `[vertices, 3]`, metres; none for frames of packed sets.
    pub(crate) minimal: Option<Array2<f64>>,
    /// RMS distance of the body of the fitted betas from the minimal shape, millimetres.
    pub(crate) residual_mm: Option<f64>,
}

impl RegistrationFile {
    /// Reads a frame's `.npz` with `pose` and `v_cano` or `v_posed`, a `.smpl` file with displacements, or
    /// `frame:K`, a test frame of the
    /// run.
    pub(crate) fn read(run: &Run, text: &str, known: &KnownBodyArgs) -> Result<Self> {
        if let Some(frame) = text.strip_prefix("frame:") {
            let frame = frame.parse().map_err(|_| {
                Error::message(format!("`{text}`: expected frame:K with a whole number K"))
            })?;
            let set = run.open_set(run.data()?, Split::Test)?;
            let (displacement, mut wearer) = cape_infer::registration(&set, frame)?;
            wearer.outfit = known.outfit_worn.unwrap_or(wearer.outfit);
            run.outfits().require(wearer.outfit)?;
            return Ok(Self { displacement, wearer, minimal: None, residual_mm: None });
        }
        let path = Path::new(text);
        if has_extension(path, "smpl") {
            return Self::from_smpl(run, path, known);
        }
        let Some(outfit) = known.outfit_worn.or_else(|| outfit_of(path)) else {
            return Err(Error::message(format!(
                "{}: the name of its directory does not begin with an outfit: give it by --was OUTFIT",
                path.display()
            )));
        };
        run.outfits().require(outfit).map_err(|error| {
            Error::message(format!("{}: {error}: give another by --was OUTFIT", path.display()))
        })?;
        let body = run.body();
        let minimal = match &known.minimal {
            Some(minimal) => read_shape(minimal, body.vertices())?,
            None => minimal_of(path, body.vertices())?,
        };
        let (v_cano, pose) = match raw::read_canonical(path, body.vertices()) {
            Ok(frame) => (frame.v_cano, frame.pose),
            Err(cause) => {
                let Ok(posed) = raw::read_posed(path, body.vertices()) else {
                    return Err(cause.into());
                };
                let v_cano =
                    body.unpose_shape(&posed.v_posed, &minimal, &posed.pose, posed.transl)?;
                (v_cano, posed.pose)
            }
        };
        let fit = body.fit_betas(&minimal, body.betas().min(10))?;
        let displacement = (&v_cano - &minimal).mapv(|x| x as f32).insert_axis(Axis(0));
        let betas = fit.betas.iter().map(|&beta| beta as f32).collect();
        Ok(Self {
            displacement,
            wearer: BodySpec { betas, pose: pose.map(|angle| angle as f32), outfit },
            minimal: Some(minimal),
            residual_mm: Some(1000.0 * fit.rms),
        })
    }
}

impl RegistrationFile {
    /// The first frame of a `.smpl` file with displacements.
    fn from_smpl(run: &Run, path: &Path, known: &KnownBodyArgs) -> Result<Self> {
        let Some(outfit) = known.outfit_worn else {
            return Err(Error::message(format!(
                "{}: give the outfit that is worn by --was OUTFIT",
                path.display()
            )));
        };
        let file = read_motion(path, &MotionOptions::default())?;
        let vertices = run.body().vertices();
        let offsets = file.offsets.as_ref().filter(|offsets| offsets.nrows() == vertices);
        let Some(offsets) = offsets else {
            return Err(Error::message(format!(
                "{}: no vertexOffsets of the body's {vertices} vertices: expected the displacements of \
                 the clothing",
                path.display()
            )));
        };
        let betas = file.betas_for(run.body().betas());
        let minimal = run.body().rest_shape(betas)?;
        Ok(Self {
            displacement: offsets.mapv(|x| x as f32).insert_axis(Axis(0)),
            wearer: BodySpec {
                betas: betas.iter().map(|&beta| beta as f32).collect(),
                pose: file.upright_poses()?[0],
                outfit,
            },
            minimal: Some(minimal),
            residual_mm: None,
        })
    }
}

/// The minimal body shape from the raw tree of a frame.
fn minimal_of(frame: &Path, vertices: usize) -> Result<Array2<f64>> {
    let subject = frame.ancestors().nth(2).and_then(Path::file_name);
    let (Some(subject), Some(root)) = (subject, frame.ancestors().nth(4)) else {
        return Err(Error::message(format!(
            "{}: not in a raw tree: give the minimal body shape by --minimal FILE.npy",
            frame.display()
        )));
    };
    read_shape(&raw::minimal_path(root, &subject.to_string_lossy()), vertices)
}

/// Rest vertices from `.npy`, `[vertices, 3]`, metres.
pub(crate) fn read_shape(path: &Path, vertices: usize) -> Result<Array2<f64>> {
    let array = read_f64(path)?;
    let fault = |found: &[usize]| {
        let message = format!("shape {found:?}, expected [{vertices}, 3]");
        cape_core::Error::format(path, message)
    };
    if array.shape() != [vertices, 3] {
        return Err(fault(array.shape()).into());
    }
    let shape = array.shape().to_vec();
    Ok(array.into_dimensionality::<Ix2>().map_err(|_| fault(&shape))?)
}

/// The outfit that the name of a capture's directory begins with.
fn outfit_of(frame: &Path) -> Option<Outfit> {
    let capture = frame.parent()?.file_name()?.to_string_lossy().into_owned();
    capture.split('_').next()?.parse().ok()
}

/// Mean distance between the rows `row` of displacements at clothing vertices, millimetres.
pub(crate) fn mean_error(run: &Run, truth: &Array3<f32>, decoded: &Array3<f32>, row: usize) -> f64 {
    let point = |of: &Array3<f32>, v: usize| [0, 1, 2].map(|axis| of[[row, v, axis]]);
    mean_distance_mm(run.clothing().iter().map(|&v| (point(truth, v), point(decoded, v))))
}
