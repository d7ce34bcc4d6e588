use std::{path::PathBuf, time::Instant};

use cape_core::{Outfit, npy::write_npy, ply};
use cape_fit::{
    BodyFit, ClothedConfig, ClothedFit, DressedBody, DressedSurface, FitProblem, ImageObservation,
    KeypointLayout, KeypointOptions, Keypoints, Mask, PinholeCamera, read_keypoints_with,
    silhouette::render,
};
use cape_infer::{AnimatedBody, BodySpec, Run, write_json};
use cape_render::{Image, Tile, contact_sheet};
use clap::Args;
use glam::DVec3;
use ndarray::{Array1, Array2};
use serde::Serialize;

use super::{drawing, method::FitMethodArgs};
use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, DressedRenderer},
    error::{Context, Error, Result},
    files,
    options::{GlobalArgs, OutfitSelection, OutputArgs, RunArgs, outfit_or, positive},
    table::Table,
};

/// Fit a clothed body to 2D keypoints and a silhouette (section 6.3 of the paper).
///
/// Fits the body by SMPLify, then body and clothing together. Writes bare.ply, clothed.ply, clothed.glb,
/// fit.json, code.npy and pose.npy for other commands, overlay.png and energy.png. Unreliable fits are
/// still written, but the command exits with an error.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape fit image runs/cape person_keypoints.json --mask person_mask.png \
                        --outfit auto --out fitted"
)]
pub(crate) struct FitArgs {
    #[command(flatten)]
    run: RunArgs,
    /// 2D keypoints: JSON of OpenPose, COCO, AlphaPose, MMPose or MediaPipe, or .npz with `keypoints`.
    #[arg(value_name = "KEYPOINTS")]
    keypoints: PathBuf,
    /// Silhouette of the person, PNG of the image's size.
    #[arg(long, value_name = "MASK.png")]
    mask: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
    /// Outfit of the run; auto fits all and keeps the one of lowest energy.
    #[arg(long, default_value = "auto", value_name = "OUTFIT", value_parser = outfit_or("auto"))]
    outfit: OutfitSelection,
    /// Fit the other outfits too and warn if one has a lower energy.
    #[arg(long)]
    compare_outfits: bool,
    /// Layout of the keypoints [default: by their number and the pose].
    #[arg(long, value_name = "LAYOUT")]
    layout: Option<KeypointLayout>,
    /// Identifier or file name of the image in a keypoint file of several images [default: the name of
    /// --image or --mask].
    #[arg(long, value_name = "ID")]
    image_id: Option<String>,
    /// Index of the person, from 0, if the file has several [default: the one on the mask].
    #[arg(long, value_name = "N")]
    person: Option<usize>,
    /// Focal length in pixels [default: the image's diagonal].
    #[arg(long, value_name = "PIXELS", value_parser = positive)]
    focal: Option<f64>,
    /// Image to draw the overlay on, PNG.
    #[arg(long, value_name = "IMAGE.png")]
    image: Option<PathBuf>,
    #[command(flatten)]
    method: FitMethodArgs,
}

/// Energy and silhouette error of the fit of an outfit.
#[derive(Debug, Clone, Serialize)]
struct OutfitFit {
    outfit: Outfit,
    /// Energy of the whole fit, by the weights of the last stage.
    energy: f64,
    /// Silhouette term `E_S`, millimetres at the person's distance.
    silhouette_mm: f64,
    intersection_over_union: f64,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    bare: BodyFit,
    clothed: ClothedFit,
    /// All fitted outfits, lowest energy first.
    outfits: Vec<OutfitFit>,
    seconds: f64,
}

/// Camera, silhouette, keypoints and image.
struct FitInput {
    camera: PinholeCamera,
    mask: Mask,
    keypoints: Keypoints,
    image: Image,
}

impl FitArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        self.output.require_empty()?;
        let config = self.method.config()?;
        let observed = self.read_input(console)?;
        let run = self.run.open(global)?;
        let smplify = self.method.smplify(run.body(), &config)?;

        let chosen = match (self.outfit, self.outfit.of(&run)?.as_slice()) {
            (OutfitSelection::One(_), &[outfit]) => Some(outfit),
            _ => None,
        };
        let start = Instant::now();
        let outfits = match chosen {
            Some(outfit) if !self.compare_outfits => vec![outfit],
            _ => run.outfits().to_vec(),
        };
        let stages = 1 + outfits.len();
        let FitInput { camera, mask, keypoints, .. } = &observed;
        let image = ImageObservation { camera, keypoints, mask };
        let (bare, fits) = console.while_showing("fit", "stages", |progress| {
            let bare = smplify.fit(camera, keypoints, None)?;
            progress(1, stages);
            let body = DressedBody::new(&run, outfits[0])?;
            let bodies: Vec<DressedBody> =
                outfits.iter().map(|&outfit| body.with_outfit(outfit)).collect::<Result<_, _>>()?;
            let clothed = &config.clothed;
            let fits = smplify.fit_outfits(&bodies, &image, &bare, clothed, &mut |done, _| {
                progress(1 + done, stages);
            })?;
            Ok::<_, cape_fit::Error>((bare, fits))
        })?;
        let tried: Vec<OutfitFit> =
            fits.iter().map(|fit| OutfitFit::from_fit(fit, &config.clothed)).collect();
        let worn = |fit: &ClothedFit| chosen.is_none_or(|outfit| fit.outfit == outfit);
        let clothed = fits.into_iter().find(worn);
        let clothed = clothed.ok_or_else(|| Error::message("no outfit to fit"))?;
        let report = Report {
            bare,
            clothed,
            outfits: tried,
            seconds: start.elapsed().as_secs_f64(),
            out: self.output.out,
        };
        report.write(&run, &observed)?;
        if let Some(better) = report.better_outfit() {
            console.note(&format!(
                "warning: {better} has a lower energy than {}",
                report.clothed.outfit
            ));
        }
        if let Some(problem) = report.problem() {
            return Err(Error::message(format!(
                "the fit in {} is unreliable: {problem}",
                report.out.display()
            )));
        }
        console.result(&report, || report.text())
    }

    fn read_input(&self, console: Console) -> Result<FitInput> {
        let mask = Mask::load(&self.mask)?;
        let camera = PinholeCamera::new(mask.width(), mask.height(), self.focal)?;
        mask.check(&camera).doing(|| format!("reading {}", self.mask.display()))?;
        let names = self.image.iter().chain([&self.mask]);
        let options = KeypointOptions {
            layout: self.layout,
            image: self.image_id.clone(),
            beside: names.filter_map(|path| Some(path.file_name()?.to_str()?.to_owned())).collect(),
            size: Some([mask.width(), mask.height()]),
        };
        let people = read_keypoints_with(&self.keypoints, &options)?;
        people.notes().iter().for_each(|note| console.note(note));
        let keypoints = people
            .index(self.person, Some(&mask))
            .and_then(|person| people.person(person))
            .doing(|| format!("reading {}", self.keypoints.display()))?;
        let image = match &self.image {
            Some(path) => Image::load(path)?,
            None => drawing::paper(&camera)?,
        };
        if (image.width(), image.height()) != (mask.width(), mask.height()) {
            return Err(Error::message(format!(
                "--image: {}×{} pixels, but the mask has {}×{}: both must be of the same size",
                image.width(),
                image.height(),
                mask.width(),
                mask.height()
            )));
        }
        Ok(FitInput { camera, mask, keypoints, image })
    }
}

impl OutfitFit {
    fn from_fit(fit: &ClothedFit, config: &ClothedConfig) -> Self {
        Self {
            outfit: fit.outfit,
            energy: fit.terms.weighted(config),
            silhouette_mm: 1000.0 * fit.terms.silhouette.total(),
            intersection_over_union: fit.intersection_over_union,
        }
    }
}

impl Report {
    /// Reason for which the fit is unreliable.
    fn problem(&self) -> Option<&FitProblem> {
        self.bare.problem.as_ref().or(self.clothed.problem.as_ref())
    }

    fn better_outfit(&self) -> Option<Outfit> {
        let best = self.outfits.first()?.outfit;
        (best != self.clothed.outfit).then_some(best)
    }

    /// Writes all files, fit.json last.
    fn write(&self, run: &Run, observed: &FitInput) -> Result {
        files::create_dir(&self.out)?;
        let Self { bare, clothed, .. } = self;
        let at = |name: &str| self.out.join(name);
        let body = &bare.parameters;
        let posed = run.body().pose(&body.betas, &body.pose, body.transl, None)?;
        ply::write(at("bare.ply"), &run.body().mesh_with(&posed.vertices), None)?;

        let code = Array1::from_iter(clothed.code.iter().map(|&x| x as f32));
        let pose = Array1::from_iter(clothed.parameters.pose.iter().map(|&x| x as f32));
        write_npy(at("code.npy"), &code)?;
        write_npy(at("pose.npy"), &pose)?;
        let wearer = body_spec(clothed)?;
        let codes = code.insert_axis(ndarray::Axis(0));
        let dressed = dressed(run, &codes, &wearer)?;
        let surface =
            DressedBody::new(run, clothed.outfit)?.surface(&clothed.parameters, &clothed.code)?;
        let mesh = drawing::mesh(surface.vertices(), &run.body().faces);
        ply::write(at("clothed.ply"), &mesh, Some(&dressed.colours_8_bit()))?;
        let performance = AnimatedBody {
            colours: Some(&dressed.colours),
            ..AnimatedBody::from_body("fitted", &codes, &wearer)
        };
        performance.save(run, at("clothed.glb"))?;
        overlay(observed, &surface, run, &dressed)?.save(at("overlay.png"))?;
        drawing::energies(bare, clothed)?.save(at("energy.png"))?;
        Ok(write_json(&at("fit.json"), self)?)
    }

    fn text(&self) -> String {
        let line = format!(
            "{} in {:.1} s: silhouette IoU {:.1} %, mean joint error {:.1} pixels\n{}",
            self.clothed.outfit,
            self.seconds,
            100.0 * self.clothed.intersection_over_union,
            self.clothed.joint_error,
            self.out.join("overlay.png").display()
        );
        if self.outfits.len() == 1 {
            return line;
        }
        let mut table = Table::new(["outfit", "energy", "silhouette, mm", "IoU"]);
        for OutfitFit { outfit, energy, silhouette_mm, intersection_over_union } in &self.outfits {
            table.row([
                outfit.to_string(),
                format!("{energy:.1}"),
                format!("{silhouette_mm:.2}"),
                format!("{:.1} %", 100.0 * intersection_over_union),
            ]);
        }
        format!("{}\n\n{line}", table.text())
    }
}

/// The fitted body.
fn body_spec(clothed: &ClothedFit) -> Result<BodySpec> {
    let pose: Vec<f32> = clothed.parameters.pose.iter().map(|&x| x as f32).collect();
    let numbers = pose.len();
    let pose = pose.try_into();
    let pose =
        pose.map_err(|_| Error::message(format!("internal error: a pose of {numbers} values")))?;
    let betas = clothed.parameters.betas.iter().map(|&x| x as f32).collect();
    Ok(BodySpec { betas, pose, outfit: clothed.outfit })
}

fn dressed(run: &Run, codes: &Array2<f32>, wearer: &BodySpec) -> Result<DressedMesh> {
    let wearers = std::slice::from_ref(wearer);
    let mut bodies = DressedRenderer::new(run)
        .pose_clothed(&run.decode_displacements(codes, wearers)?, wearers)?;
    bodies.pop().ok_or_else(|| Error::message("internal error: no mesh was produced"))
}

/// The image with its keypoints, the difference of the silhouettes, and the fitted body over it.
fn overlay(
    observed: &FitInput,
    surface: &DressedSurface,
    run: &Run,
    dressed: &DressedMesh,
) -> Result<Image> {
    let FitInput { camera, mask, keypoints, image } = observed;
    let vertices: &[DVec3] = surface.vertices();
    let faces = &run.body().faces;
    let mut seen = image.clone();
    drawing::mark(&mut seen, keypoints);
    let mut silhouettes = image.clone();
    drawing::difference(&mut silhouettes, mask, render(vertices, faces, camera)?.mask());
    let mut fitted = image.clone();
    drawing::body(&mut fitted, vertices, faces, Some(&dressed.colours), camera)?;
    let tiles = [(seen, "keypoints"), (silhouettes, "red: mask, blue: fit"), (fitted, "fit")];
    let tiles = tiles.map(|(image, label)| Tile { image, label: label.into() });
    Ok(contact_sheet(&tiles, 3, None)?)
}
