use std::path::{Path, PathBuf};

use cape_core::{Outfit, npy::read_f64, parse_device, ply, poses::poses};
use cape_render::{Tile, View, contact_sheet};
use cape_train::{
    Run, Wearer,
    data::{PackedSet, Part, raw},
    write_json,
};
use clap::Args;
use ndarray::{Array2, Array3, Axis, Ix2, concatenate};
use serde::Serialize;

use crate::{
    arguments::{Global, outfit},
    console::Console,
    dressed::Painter,
    error::{Error, Result},
    files,
};

/// Reconstruct a registration, and change its outfit and pose.
///
/// Its clothes are encoded to a code, and decoded under the pose and outfit it has, under other
/// outfits, and under other poses. Writes coloured meshes, a picture and redress.json with the code.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape redress run raw/sequences/00032/shortlong_hips/000010.npz --out new\n  \
                  cape redress run frame:12 --outfit longlong --pose a-pose,squats --out new"
)]
pub(crate) struct Redress {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// A frame's .npz with pose and v_cano, or v_posed; or frame:K of the run's held-out data.
    #[arg(value_name = "REGISTRATION")]
    registration: String,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What the registration wears; by default as its directory says.
    #[arg(long, value_name = "OUTFIT", value_parser = outfit)]
    was: Option<Outfit>,
    /// The body under the clothes, .npy of [vertices, 3]; by default the raw tree's.
    #[arg(long, value_name = "FILE.npy")]
    minimal: Option<PathBuf>,
    /// What is worn instead; by default each outfit.
    #[arg(long, value_delimiter = ',', value_name = "OUTFIT,…", value_parser = outfit)]
    outfit: Vec<Outfit>,
    /// Further poses, as for `cape sample`.
    #[arg(long, value_delimiter = ',', value_name = "POSE,…")]
    pose: Vec<String>,
}

/// Clothes as they were registered.
struct Registration {
    /// `[1, vertices, 3]`, metres.
    displacement: Array3<f32>,
    wearer: Wearer,
    /// Distance of the body that the betas describe from the minimal one, millimetres.
    residual_mm: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    outfit: Outfit,
    code: Vec<f32>,
    betas: Vec<f32>,
    /// Of the body that the betas describe, from the minimal one.
    residual_mm: Option<f64>,
    /// Mean error of the reconstruction at clothing vertices.
    error_mm: f64,
    files: Vec<String>,
}

impl Redress {
    pub(crate) fn run(self, global: &Global, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        files::require_empty(&self.out)?;
        let mut others = Vec::new();
        for text in &self.pose {
            others.extend(poses(text)?);
        }
        let run = Run::open(&self.run, &device)?;
        let registration = self.read(&run)?;
        let wearer = &registration.wearer;
        let code = run.encode(&registration.displacement, std::slice::from_ref(wearer))?;

        let outfits = if self.outfit.is_empty() { Outfit::ALL.to_vec() } else { self.outfit };
        let mut changed = vec![("reconstruction".to_owned(), wearer.clone())];
        changed.extend(
            outfits
                .iter()
                .filter(|&&outfit| outfit != wearer.outfit)
                .map(|&outfit| (outfit.name().to_owned(), Wearer { outfit, ..wearer.clone() })),
        );
        changed.extend(
            others.into_iter().map(|(name, pose)| (name, Wearer { pose, ..wearer.clone() })),
        );
        let (names, wearers): (Vec<String>, Vec<Wearer>) = changed.into_iter().unzip();
        let codes = code.select(Axis(0), &vec![0; wearers.len()]);
        let decoded = run.clothes(&codes, &wearers)?;
        let error_mm = mean_error(&run, &registration.displacement, &decoded);

        let worn = concatenate(Axis(0), &[registration.displacement.view(), decoded.view()])
            .map_err(|error| Error::message(error.to_string()))?;
        let all: Vec<Wearer> = [wearer.clone()].into_iter().chain(wearers).collect();
        let bodies = Painter::new(&run).wear(&worn, &all)?;
        let names = ["registration".to_owned()].into_iter().chain(names);
        files::create_dir(&self.out)?;
        let (mut tiles, mut written) = (Vec::new(), Vec::new());
        for (index, (name, body)) in names.zip(&bodies).enumerate() {
            let file = format!("{index}-{}.ply", name.replace(['/', ' '], "-"));
            ply::write(self.out.join(&file), &body.mesh, Some(&body.colours_8_bit()))?;
            tiles.push(Tile {
                image: body.picture(View::ThreeQuarter, [280, 400], None)?,
                label: name,
            });
            written.push(file);
        }
        contact_sheet(&tiles, tiles.len().min(6), None)?.save(self.out.join("redress.png"))?;
        let report = Report {
            outfit: wearer.outfit,
            code: code.row(0).to_vec(),
            betas: wearer.betas.clone(),
            residual_mm: registration.residual_mm,
            error_mm,
            files: written,
            out: self.out,
        };
        write_json(&report.out.join("redress.json"), &report)?;
        console.result(&report, || {
            let out = report.out.display();
            format!("reconstructed within {error_mm:.2} mm in the mean\n{out}/redress.png")
        })
    }

    fn read(&self, run: &Run) -> Result<Registration> {
        if let Some(frame) = self.registration.strip_prefix("frame:") {
            let frame = frame.parse().map_err(|_| {
                Error::message(format!("`{}`: expected frame:NUMBER", self.registration))
            })?;
            return self.of_packed(run, frame);
        }
        let path = Path::new(&self.registration);
        let Some(outfit) = self.was.or_else(|| outfit_of(path)) else {
            return Err(Error::message(format!(
                "{}: its directory does not say what is worn: give --was OUTFIT",
                path.display()
            )));
        };
        let body = run.body();
        let minimal = self.minimal(path, body.vertices())?;
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
        Ok(Registration {
            displacement,
            wearer: Wearer { betas, pose: pose.map(|angle| angle as f32), outfit },
            residual_mm: Some(1000.0 * fit.rms),
        })
    }

    fn of_packed(&self, run: &Run, frame: usize) -> Result<Registration> {
        let set = PackedSet::open(&run.data()?, Part::Test)?;
        let (displacement, mut wearer) = set.registration(frame)?;
        wearer.outfit = self.was.unwrap_or(wearer.outfit);
        Ok(Registration { displacement, wearer, residual_mm: None })
    }

    /// The body under the clothes: as given, or of the raw tree that the frame is in.
    fn minimal(&self, frame: &Path, vertices: usize) -> Result<Array2<f64>> {
        let path = if let Some(path) = &self.minimal {
            path.clone()
        } else {
            let subject = frame.ancestors().nth(2).and_then(Path::file_name);
            let (Some(subject), Some(root)) = (subject, frame.ancestors().nth(4)) else {
                return Err(Error::message(format!(
                    "{}: is not in a raw tree: give the body under the clothes by --minimal",
                    frame.display()
                )));
            };
            raw::minimal_path(root, &subject.to_string_lossy())
        };
        let array = read_f64(&path)?;
        let fault = |found: &[usize]| {
            let message = format!("shape {found:?}, expected [{vertices}, 3]");
            cape_core::Error::format(&path, message)
        };
        if array.shape() != [vertices, 3] {
            return Err(fault(array.shape()).into());
        }
        let shape = array.shape().to_vec();
        Ok(array.into_dimensionality::<Ix2>().map_err(|_| fault(&shape))?)
    }
}

/// What the directory of a capture says is worn: its name begins with the outfit.
fn outfit_of(frame: &Path) -> Option<Outfit> {
    let capture = frame.parent()?.file_name()?.to_string_lossy().into_owned();
    capture.split('_').next()?.parse().ok()
}

/// Between the first of each at clothing vertices, millimetres.
fn mean_error(run: &Run, truth: &Array3<f32>, decoded: &Array3<f32>) -> f64 {
    let distance = |&v: &usize| {
        let squares = (0..3).map(|i| f64::from(truth[[0, v, i]] - decoded[[0, v, i]]).powi(2));
        squares.sum::<f64>().sqrt()
    };
    1000.0 * run.clothing().iter().map(distance).sum::<f64>() / run.clothing().len().max(1) as f64
}
