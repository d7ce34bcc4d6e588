use std::{path::PathBuf, time::Instant};

use cape_core::{Mesh, Outfit, npy::write_npy, parse_device, ply};
use cape_fit::{
    BodyFit, Camera, ClothedConfig, ClothedFit, DressedBody, Keypoints, Mask, PosePrior, Smplify,
    SmplifyConfig, read_keypoints, silhouette::render,
};
use cape_render::Image;
use cape_train::{Run, write_json};
use clap::Args;
use glam::DVec3;
use ndarray::Array1;
use serde::Serialize;

use crate::{
    arguments::Global,
    console::Console,
    error::{Context, Error, Result},
    files,
};

/// Width of soft edges, pixels.
const SOFTNESS: f64 = 0.5;

/// Fit a clothed body to keypoints and a silhouette (section 6.3 of the paper).
///
/// First the bare body by SMPLify, then body and clothes together. Writes both as meshes, fit.json,
/// the code and the pose for other commands, and overlay.png. A fit that cannot be trusted is
/// written too, and is an error. `cape fit RUN --scan FILE` fits to a scan: see `cape fit-scan --help`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape fit run person_keypoints.json --mask person.png \
                        --outfit auto --out fitted")]
pub(crate) struct Fit {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Keypoints: OpenPose's or COCO's JSON, or .npz with `keypoints`.
    #[arg(value_name = "KEYPOINTS")]
    keypoints: PathBuf,
    /// The silhouette, PNG, as large as the image.
    #[arg(long, value_name = "MASK.png")]
    mask: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What is worn; with `auto`, what explains the silhouette best.
    #[arg(long, default_value = "auto", value_name = "OUTFIT|auto")]
    outfit: String,
    /// Which person, if the file has several, counted from 0.
    #[arg(long, value_name = "N")]
    person: Option<usize>,
    /// How silhouettes are compared: by distances, or finely by what soft edges cover.
    #[arg(long, default_value = "distance", value_parser = ["distance", "soft"], value_name = "WAY")]
    silhouette: String,
    /// Focal length, pixels; by default the image's diagonal.
    #[arg(long, value_name = "PIXELS")]
    focal: Option<f64>,
    /// The image, PNG, to draw over.
    #[arg(long, value_name = "IMAGE.png")]
    image: Option<PathBuf>,
    /// The pose prior: SMPLify's pickle, or .npz; by default one of synthetic movements.
    #[arg(long, value_name = "FILE")]
    pose_prior: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    bare: BodyFit,
    clothed: ClothedFit,
    seconds: f64,
}

impl Fit {
    pub(crate) fn run(self, global: &Global, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        files::require_empty(&self.out)?;
        let outfits = match self.outfit.as_str() {
            "auto" => Outfit::ALL.to_vec(),
            name => vec![name.parse::<Outfit>()?],
        };
        let mask = Mask::load(&self.mask)?;
        let camera = Camera::new(mask.width(), mask.height(), self.focal)?;
        mask.check(&camera)?;
        let keypoints = read_keypoints(&self.keypoints)?
            .choose(self.person)
            .doing(|| format!("reading {}", self.keypoints.display()))?;
        let image = self.image.as_ref().map(Image::load).transpose()?;
        if let Some(image) = &image
            && (image.width(), image.height()) != (mask.width(), mask.height())
        {
            return Err(Error::message(format!(
                "--image of {}×{} pixels, but the mask has {}×{}",
                image.width(),
                image.height(),
                mask.width(),
                mask.height()
            )));
        }
        let prior = match &self.pose_prior {
            Some(path) => PosePrior::load(path)?,
            None => PosePrior::synthetic()?,
        };
        let run = Run::open(&self.run, &device)?;
        let smplify = Smplify::new(run.body(), prior, SmplifyConfig::default())?;
        let soft = (self.silhouette == "soft").then_some(SOFTNESS);
        let config = ClothedConfig { soft, ..ClothedConfig::default() };

        let start = Instant::now();
        let stages = 1 + outfits.len();
        let (bare, fits) = console.while_showing("fit", "stages", |progress| {
            let bare = smplify.fit(&camera, &keypoints, None)?;
            progress(1, stages);
            let mut fits = Vec::new();
            for (index, &outfit) in outfits.iter().enumerate() {
                let dressed = DressedBody::new(&run, outfit)?;
                let fit =
                    smplify.fit_clothed(&dressed, &camera, &keypoints, &mask, &bare, &config)?;
                fits.push((dressed, fit));
                progress(2 + index, stages);
            }
            Ok::<_, cape_fit::Error>((bare, fits))
        })?;
        let seconds = start.elapsed().as_secs_f64();
        let energy = |fit: &ClothedFit| fit.terms.weighted(&config);
        let best = fits.into_iter().min_by(|a, b| energy(&a.1).total_cmp(&energy(&b.1)));
        let (dressed, clothed) = best.ok_or_else(|| Error::message("no outfit to fit"))?;

        files::create_dir(&self.out)?;
        let surface = dressed.surface(&clothed.parameters, &clothed.code)?;
        let body = &bare.parameters;
        let posed = run.body().pose(&body.betas, &body.pose, body.transl, None)?;
        self.save("bare.ply", &run.body().mesh_with(&posed.vertices))?;
        self.save("clothed.ply", &mesh(surface.vertices(), dressed.faces()))?;
        let code = Array1::from_iter(clothed.code.iter().map(|&x| x as f32));
        write_npy(self.out.join("code.npy"), &code)?;
        let pose = Array1::from_iter(clothed.parameters.pose.iter().map(|&x| x as f32));
        write_npy(self.out.join("pose.npy"), &pose)?;
        let drawn = render(surface.vertices(), dressed.faces(), &camera)?;
        let overlay = overlay(image, &mask, drawn.mask(), &keypoints)?;
        overlay.save(self.out.join("overlay.png"))?;

        let report = Report { out: self.out, bare, clothed, seconds };
        write_json(&report.out.join("fit.json"), &report)?;
        if let Some(problem) = report.bare.problem.as_ref().or(report.clothed.problem.as_ref()) {
            return Err(Error::message(format!(
                "the fit in {} cannot be trusted: {problem}",
                report.out.display()
            )));
        }
        console.result(&report, || {
            format!(
                "{} in {:.1} s: silhouettes agree to {:.1} %, joints to {:.1} pixels\n{}",
                report.clothed.outfit,
                report.seconds,
                100.0 * report.clothed.intersection_over_union,
                report.clothed.joint_error,
                report.out.join("overlay.png").display()
            )
        })
    }

    fn save(&self, name: &str, mesh: &Mesh) -> Result {
        Ok(ply::write(self.out.join(name), mesh, None)?)
    }
}

fn mesh(vertices: &[DVec3], faces: &[[u32; 3]]) -> Mesh {
    let vertices = vertices.iter().map(|v| v.to_array().map(|x| x as f32)).collect();
    Mesh { vertices, faces: faces.to_vec() }
}

/// The image, or grey, with what only the mask covers in red, what only the fit covers in blue, what
/// both cover in green, and the keypoints.
pub(super) fn overlay(
    image: Option<Image>,
    mask: &Mask,
    fitted: &Mask,
    keypoints: &Keypoints,
) -> Result<Image> {
    let mut picture = match image {
        Some(image) => image,
        None => Image::new(mask.width(), mask.height(), [235, 235, 238, 255])?,
    };
    let width = mask.width() as usize;
    for (at, (&wanted, &found)) in mask.covered().iter().zip(fitted.covered()).enumerate() {
        let colour = match (wanted, found) {
            (false, false) => continue,
            (true, false) => [214, 69, 65],
            (false, true) => [65, 105, 214],
            (true, true) => [90, 170, 110],
        };
        picture.blend((at % width) as i64, (at / width) as i64, colour, 0.55);
    }
    for point in keypoints.points().iter().filter(|point| point.confidence > 0.0) {
        for (dx, dy) in (-2..=2).flat_map(|dx| (-2..=2).map(move |dy| (dx, dy))) {
            picture.blend(point.x as i64 + dx, point.y as i64 + dy, [250, 210, 60], 1.0);
        }
    }
    Ok(picture)
}
