mod names;

use std::path::{Path, PathBuf};

use cape_core::{
    BodyMotion, BodyPose, KeyframeRule, Outfit,
    gltf::GltfTexture,
    motion::{DEFAULT_FRAME_RATE, SmplFile},
    obj::{self, Uv},
    ply,
};
use cape_eval::clothing::at_clothing;
use cape_infer::{AnimatedBody, BodySpec, Run};
use cape_render::{Image, Texture as Painted, Tile, View, contact_sheet};
use clap::{Args, ValueEnum};
use serde::Serialize;

use names::NameFields;

use crate::{
    console::Console,
    dressed_mesh::{DressedMesh, dress, unclothed_meshes},
    error::{Error, Result},
    files,
    motion_source::MotionFileArgs,
    options::{
        FileKind, GlobalArgs, OutfitSelection, OutputArgs, RunArgs, ShapeArgs, at_least_one, kinds,
        outfit_or, positive,
    },
    priors::PriorArgs,
    table::Table,
};

/// Width and height of a picture, pixels.
const TILE: [u32; 2] = [320, 420];
/// Largest number of bodies on the contact sheet.
const MOST_PICTURES: usize = 32;
/// Material file of textured .obj files.
const MATERIALS: &str = "body.mtl";
/// Most bodies per row of the contact sheet.
const WIDEST: usize = 8;
/// Bodies per row of the contact sheet, if there is one outfit.
const COLUMNS: usize = 6;

/// Sample clothing and write dressed bodies as meshes.
///
/// Samples latent codes from the prior, decodes them for pose and outfit, and writes posed meshes,
/// samples.jsonl with the parameters of each, and contact_sheet.png. All poses of a file share their
/// codes, and so do all outfits with the standard normal prior.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape sample runs/cape --outfit all --pose a-pose --out samples\n  cape \
                        sample runs/cape --outfit longlong --pose dance.npy --n 3 --betas 1,-0.5 \
                        --format glb --out dancing"
)]
pub(crate) struct SampleArgs {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    output: OutputArgs,
    /// Outfit of the run, see `cape info RUN`; or all of them.
    #[arg(long, default_value = "all", value_name = "OUTFIT", value_parser = outfit_or("all"))]
    outfit: OutfitSelection,
    /// Pose: t-pose, a-pose, a motion (walk, squats, …) or a file of poses.
    #[arg(long, default_value = "a-pose", value_name = "POSE")]
    pose: String,
    #[command(flatten)]
    poses: MotionFileArgs,
    #[command(flatten)]
    shape: ShapeArgs,
    /// Number of latent codes to sample.
    #[arg(long, short, default_value_t = 1, value_name = "K", value_parser = at_least_one)]
    n: usize,
    #[command(flatten)]
    drawn: PriorArgs,
    /// File format: ply has colours; glb and usda also skeleton and skinning, and animate the poses of a
    /// file; smpl has pose, shape and displacements.
    #[arg(long, default_value = "obj", value_name = "FORMAT", value_parser = kinds([FileKind::Obj, FileKind::Ply, FileKind::Glb, FileKind::Usda, FileKind::Smpl]))]
    format: FileKind,
    /// File names from {outfit}, {sample}, {frame}, {pose} and {seed} [default: {outfit}_{sample}].
    #[arg(long, value_name = "TEMPLATE")]
    name: Option<String>,
    /// Colours of ply and glb: cloth and skin, or length of the displacement.
    #[arg(long, value_enum, default_value_t = Colours::Cloth, value_name = "COLOURS")]
    colours: Colours,
    /// Displacement of the brightest colour, mm.
    #[arg(long, default_value_t = 50.0, value_name = "MM", value_parser = positive)]
    scale: f64,
    /// OBJ file of the body with texture coordinates, such as SMPL's.
    #[arg(long, value_name = "FILE.obj")]
    uv: Option<PathBuf>,
    /// Texture of obj and glb, PNG or JPEG.
    #[arg(long, value_name = "FILE", requires = "uv")]
    texture: Option<PathBuf>,
    /// Frames per second of an animated glb or usda; a file of another rate is resampled [default: those of
    /// the file].
    #[arg(long, value_name = "FPS", value_parser = positive)]
    fps: Option<f64>,
    /// Number of shape directions to add to glb as morph targets.
    #[arg(long, default_value_t = 0, value_name = "N")]
    shape_targets: usize,
    /// Write no contact sheet.
    #[arg(long)]
    no_picture: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Colours {
    Cloth,
    Displacement,
}

/// Texture coordinates and texture.
#[derive(Debug, Default)]
struct TextureInput {
    uv: Option<Uv>,
    /// Name of the texture's file beside the meshes, and its bytes.
    image: Option<(String, Vec<u8>)>,
    /// The texture, if it can be drawn on the contact sheet.
    drawn: Option<Image>,
}

/// A line of samples.jsonl.
#[derive(Debug, Serialize)]
struct SampleLine {
    file: String,
    outfit: Outfit,
    pose: String,
    axis_angles: Vec<f32>,
    /// Number of poses in the file.
    frames: usize,
    betas: Vec<f32>,
    seed: u64,
    sample: usize,
    code: Vec<f32>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    files: Vec<String>,
    picture: Option<PathBuf>,
}

impl SampleArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let mut file = self.poses.poses(&self.pose, console)?;
        if file.frame_rate.is_none() {
            // The option names the rate of a file that says none, and nothing is resampled.
            file.frame_rate = self.fps;
        }
        self.output.require_empty()?;
        let out = &self.output.out;
        let run = self.run.open(global)?;
        let betas = self.shape.betas(run.body())?;
        let shape: Vec<f64> = betas.iter().map(|&beta| beta.into()).collect();
        let animated = matches!(self.format, FileKind::Glb | FileKind::Usda);
        let rate = self.fps.filter(|_| animated);
        let motion = file.motion_of(run.body(), &shape, rate)?;
        let poses: Vec<(String, BodyPose)> =
            (0..motion.frames()).map(|frame| (file.pose_name(frame), motion.pose(frame))).collect();
        let skin = self.skin(&run)?;
        if skin.image.is_some() && skin.drawn.is_none() {
            console.note("the contact sheet is drawn without the texture: only PNG can be drawn");
        }
        let seed = global.seed();
        let outfits = self.outfit.of(&run)?;
        let codes = self.drawn.codes(&run, &outfits, self.n, seed, console)?;
        // All poses of an animation are in one file, which is listed and drawn in its first.
        let shown = if animated { &poses[..1] } else { &poses[..] };
        let (mut wearers, mut rows, mut lines) = (Vec::new(), Vec::new(), Vec::new());
        for sample in 0..self.n {
            for (frame, (pose_name, pose_angles)) in shown.iter().enumerate() {
                for (place, &outfit) in outfits.iter().enumerate() {
                    let code = sample + place * self.n;
                    wearers.push(BodySpec { betas: betas.clone(), pose: *pose_angles, outfit });
                    rows.push(code);
                    let frames = shown.len();
                    let pose = pose_name;
                    let fields = NameFields { outfit, sample, frame, frames, pose, seed };
                    lines.push(SampleLine {
                        file: self.file_name(&fields)?,
                        outfit,
                        pose: pose_name.clone(),
                        frames: poses.len() / shown.len(),
                        axis_angles: pose_angles.to_vec(),
                        betas: betas.clone(),
                        seed,
                        sample,
                        code: codes.row(code).to_vec(),
                    });
                }
            }
        }
        let files: Vec<String> = lines.iter().map(|line| line.file.clone()).collect();
        let codes = codes.select(ndarray::Axis(0), &rows);
        names::require_distinct(files.iter().map(String::as_str))?;
        files::create_dir(out)?;
        if let Some((name, image)) = skin.image.as_ref().filter(|_| self.format == FileKind::Obj) {
            files::write_bytes(&out.join(name), image)?;
            let material = format!("newmtl body\nKd 1 1 1\nmap_Kd {name}\n");
            files::write_text(&out.join(MATERIALS), &material)?;
        }
        let mut tiles = Vec::new();
        if skin.drawn.is_some() && !self.no_picture {
            // The body with the same texture, to compare with.
            for body in unclothed_meshes(&run, &wearers[..1])? {
                let image = body.picture(View::ThreeQuarter, TILE, skin.on())?;
                tiles.push(Tile { image, label: "body".into() });
            }
        }
        console.while_showing("sample", "bodies", |progress| {
            dress(&run, &codes, &wearers, |index, mut dressed| {
                let line = &lines[index];
                if self.colours == Colours::Displacement {
                    dressed.colour_by_distance(self.scale as f32 / 1000.0);
                }
                if animated {
                    let performance = AnimatedBody {
                        name: line.file.trim_end_matches(self.format.name()).trim_end_matches('.'),
                        code: codes.select(ndarray::Axis(0), &[index]),
                        betas: &betas,
                        outfit: line.outfit,
                        motion: motion.clone(),
                        keyframes: KeyframeRule::default(),
                        displacements: None,
                        shape_targets: self.shape_targets,
                        colours: skin.image.is_none().then_some(&dressed.colours[..]),
                        texture: skin.texture(),
                    };
                    performance.save(&run, out.join(&line.file))?;
                } else if self.format == FileKind::Smpl {
                    let body = &wearers[index..=index];
                    let codes = codes.select(ndarray::Axis(0), &[index]);
                    let worn = run.decode_displacements(&codes, body)?;
                    let offsets = at_clothing(&run, worn.index_axis(ndarray::Axis(0), 0));
                    let motion = BodyMotion::from_poses(DEFAULT_FRAME_RATE, &[body[0].pose])?;
                    let file = SmplFile {
                        motion: &motion,
                        betas: &shape,
                        gender: None,
                        offsets: Some(&offsets),
                    };
                    file.save(out.join(&line.file))?;
                } else {
                    self.write(&out.join(&line.file), &dressed, &skin)?;
                }
                if !self.no_picture && index < MOST_PICTURES {
                    tiles.push(tile(&dressed, line, &skin)?);
                }
                progress(index + 1, wearers.len());
                Ok(())
            })
        })?;
        files::write_json_lines(&out.join("samples.jsonl"), &lines)?;
        let picture = self.picture(&tiles, outfits.len())?;
        let report = Report { files, picture, out: self.output.out };
        console.result(&report, || report.text(&lines))
    }

    fn file_name(&self, fields: &NameFields) -> Result<String> {
        let name = match &self.name {
            Some(template) => names::fill(template, fields)?,
            None => names::default(fields),
        };
        Ok(format!("{name}.{}", self.format.name()))
    }

    /// Reads texture coordinates and texture.
    fn skin(&self, run: &Run) -> Result<TextureInput> {
        let Some(path) = &self.uv else { return Ok(TextureInput::default()) };
        let read = obj::read(path)?;
        let fault = |message: String| Error::message(format!("{}: {message}", path.display()));
        let body = run.body();
        let (found, expected) = (read.mesh.vertices.len(), body.vertices());
        if found != expected {
            return Err(fault(format!(
                "{found} vertices, but the run's body has {expected}: expected an OBJ file of the same \
                 mesh, with its vertices in the same order"
            )));
        }
        let uv = read.uv.ok_or_else(|| {
            fault("no texture coordinates (vt), or not at all corners of its faces".into())
        })?;
        let uv = uv.for_faces(&read.mesh.faces, &body.faces).map_err(|face| {
            fault(format!(
                "has no triangle of the vertices {:?} (from 0), which is face {face} of the run's body: \
                 expected an OBJ file of the same mesh, with its vertices in the same order",
                body.faces[face]
            ))
        })?;
        let image = match &self.texture {
            None => None,
            Some(path) => {
                let bytes = std::fs::read(path).map_err(|error| Error::io(path, error))?;
                let extension = match &bytes[..] {
                    [0x89, b'P', b'N', b'G', ..] => "png",
                    [0xff, 0xd8, 0xff, ..] => "jpg",
                    _ => {
                        return Err(Error::message(format!(
                            "{}: expected a PNG or a JPEG file",
                            path.display()
                        )));
                    }
                };
                Some((format!("texture.{extension}"), bytes))
            }
        };
        let drawn = match (&self.texture, &image) {
            (Some(path), Some(_)) => Image::load(path).ok(),
            _ => None,
        };
        Ok(TextureInput { uv: Some(uv), image, drawn })
    }

    fn write(&self, path: &Path, dressed: &DressedMesh, skin: &TextureInput) -> Result {
        if self.format == FileKind::Ply {
            ply::write(path, &dressed.mesh, Some(&dressed.colours_8_bit()))?;
        } else {
            let material = skin.image.is_some().then_some((MATERIALS, "body"));
            obj::write_with(path, &dressed.mesh, skin.uv.as_ref(), material)?;
        }
        Ok(())
    }

    fn picture(&self, tiles: &[Tile], outfits: usize) -> Result<Option<PathBuf>> {
        if tiles.is_empty() {
            return Ok(None);
        }
        let columns = match (self.outfit, tiles.len()) {
            // One of each beside the body.
            (OutfitSelection::All, tiles) if tiles == outfits + 1 && tiles <= WIDEST => tiles,
            (OutfitSelection::All, _) => outfits.min(WIDEST),
            _ => COLUMNS,
        };
        let path = self.output.out.join("contact_sheet.png");
        contact_sheet(tiles, columns, None)?.save(&path)?;
        Ok(Some(path))
    }
}

fn tile(dressed: &DressedMesh, line: &SampleLine, skin: &TextureInput) -> Result<Tile> {
    let label = format!("{} {} {}", line.outfit, line.sample + 1, line.pose);
    Ok(Tile { image: dressed.picture(View::ThreeQuarter, TILE, skin.on())?, label })
}

impl TextureInput {
    /// Texture to draw pictures with.
    fn on(&self) -> Option<Painted<'_>> {
        Some(Painted { uv: self.uv.as_ref()?, image: self.drawn.as_ref()? })
    }

    fn texture(&self) -> Option<GltfTexture<'_>> {
        let image = self.image.as_ref().map(|(_, bytes)| bytes.as_slice());
        Some(GltfTexture { uv: self.uv.as_ref()?, image })
    }
}

impl Report {
    fn text(&self, lines: &[SampleLine]) -> String {
        let mut table = Table::new(["file", "outfit", "pose"]);
        for line in lines.iter().take(20) {
            table.row([line.file.as_str(), line.outfit.name(), line.pose.as_str()]);
        }
        let more = match lines.len().saturating_sub(20) {
            0 => String::new(),
            more => format!("\n… and {more} more"),
        };
        format!("{}{more}\n\n{}", table.text(), self.out.display())
    }
}
