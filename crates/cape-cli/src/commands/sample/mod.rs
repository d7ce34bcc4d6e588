mod names;

use std::path::{Path, PathBuf};

use cape_core::{
    Outfit,
    gltf::GltfTexture,
    obj::{self, Uv},
    parse_device, ply,
};
use cape_infer::{AnimatedBody, BodySpec, Run};
use cape_render::{Image, Texture as Painted, Tile, View, contact_sheet};
use cape_synth::poses::poses;
use clap::{Args, ValueEnum};
use serde::Serialize;

use names::NameFields;

use crate::{
    arguments::{GlobalArgs, at_least_one},
    console::Console,
    dressed_mesh::{DressedMesh, dress, unclothed_meshes},
    error::{Error, Result},
    files,
    priors::PriorArgs,
    table::Table,
};

/// Pixels of a picture.
const TILE: [u32; 2] = [320, 420];
/// Bodies that a contact sheet shows at most.
const MOST_PICTURES: usize = 32;
/// What textured .obj files refer to.
const MATERIALS: &str = "body.mtl";
/// Bodies in a row of it, if there is one outfit.
const COLUMNS: usize = 6;

/// Dress bodies in clothes drawn from a trained model.
///
/// Draws codes from the prior, decodes them under a pose and an outfit, and writes posed meshes,
/// samples.jsonl with what each was made from, and contact_sheet.png. The same code is used for all
/// poses of a file and, from the standard normal prior, for all outfits.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape sample run --outfit all --pose a-pose --out samples\n  \
                        cape sample run --outfit longlong --pose dance.npy --n 3 --betas 1,-0.5 \
                        --format glb --out samples")]
pub(crate) struct SampleArgs {
    /// A training run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What is worn.
    #[arg(long, value_enum, default_value_t = OutfitName::All)]
    outfit: OutfitName,
    /// t-pose, a-pose, a movement (walk, squats, punching, …), or a file: .npy [72] or [n, 72], or
    /// .npz with `pose` or `poses`.
    #[arg(long, default_value = "a-pose", value_name = "POSE")]
    pose: String,
    /// Shape coefficients of the body; missing ones are zero.
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, value_name = "B,B,…")]
    betas: Vec<f32>,
    /// Codes to draw.
    #[arg(long, short, default_value_t = 1, value_name = "K", value_parser = at_least_one)]
    n: usize,
    #[command(flatten)]
    drawn: PriorArgs,
    /// Kind of mesh file: .ply comes with colours; .glb with colours, skeleton and skin, and with
    /// the poses of a file as one animation.
    #[arg(long, value_enum, default_value_t = Format::Obj)]
    format: Format,
    /// Names of the files, made of {outfit}, {sample}, {frame}, {pose} and {seed}.
    #[arg(long, value_name = "TEMPLATE")]
    name: Option<String>,
    /// Colours of .ply and .glb: cloth and skin, or the length of the displacement.
    #[arg(long, value_enum, default_value_t = Colours::Cloth)]
    colours: Colours,
    /// Length of displacement that gets the brightest colour, millimetres.
    #[arg(long, default_value_t = 50.0, value_name = "MM")]
    scale: f32,
    /// Texture coordinates: an OBJ file of the body, such as SMPL's.
    #[arg(long, value_name = "FILE.obj")]
    uv: Option<PathBuf>,
    /// Texture, PNG or JPEG, for .obj and .glb.
    #[arg(long, value_name = "FILE", requires = "uv")]
    texture: Option<PathBuf>,
    /// Poses a second of an animation.
    #[arg(long, default_value_t = 30.0, value_name = "FPS")]
    fps: f32,
    /// Shape directions that a .glb gets as morph targets.
    #[arg(long, default_value_t = 0, value_name = "N")]
    shape_targets: usize,
    /// Write no contact sheet.
    #[arg(long)]
    no_picture: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "lowercase")]
enum OutfitName {
    All,
    ShortLong,
    ShortShort,
    LongShort,
    LongLong,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Obj,
    Ply,
    Glb,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Colours {
    Cloth,
    Displacement,
}

/// Texture coordinates and picture, as they were given.
#[derive(Debug, Default)]
struct TextureInput {
    uv: Option<Uv>,
    /// The picture's name beside the meshes, and its bytes.
    image: Option<(String, Vec<u8>)>,
    /// The picture, if it is one that can be drawn.
    drawn: Option<Image>,
}

/// A line of samples.jsonl.
#[derive(Debug, Serialize)]
struct SampleLine {
    file: String,
    outfit: Outfit,
    pose: String,
    axis_angles: Vec<f32>,
    /// Poses in the file.
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

impl OutfitName {
    fn outfits(self) -> Vec<Outfit> {
        match self {
            Self::All => Outfit::ALL.to_vec(),
            Self::ShortLong => vec![Outfit::ShortLong],
            Self::ShortShort => vec![Outfit::ShortShort],
            Self::LongShort => vec![Outfit::LongShort],
            Self::LongLong => vec![Outfit::LongLong],
        }
    }
}

impl SampleArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        let device = parse_device(&global.device)?;
        let poses = poses(&self.pose)?;
        if let Some(beta) = self.betas.iter().find(|beta| !beta.is_finite()) {
            return Err(Error::message(format!("--betas: {beta} is not a finite number")));
        }
        files::require_empty(&self.out)?;
        let run = Run::open(&self.run, &device)?;
        let most = run.body().betas();
        if self.betas.len() > most {
            let given = self.betas.len();
            return Err(Error::message(format!("--betas: {given}, but the body has {most}")));
        }
        for (option, value) in [("--fps", self.fps), ("--scale", self.scale)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::message(format!("{option} {value}: expected more than 0")));
            }
        }
        let skin = self.skin(&run)?;
        if skin.image.is_some() && skin.drawn.is_none() {
            console
                .note("the contact sheet is without the texture: it can draw whole PNG files only");
        }
        let seed = global.seed.unwrap_or(1);
        let outfits = self.outfit.outfits();
        let codes = self.drawn.codes(&run, &outfits, self.n, seed, console)?;
        // All poses of an animation are in one file, which is listed and drawn in its first.
        let shown = match self.format {
            Format::Glb => &poses[..1],
            _ => &poses[..],
        };
        let (mut wearers, mut rows, mut lines) = (Vec::new(), Vec::new(), Vec::new());
        for sample in 0..self.n {
            for (frame, (pose_name, pose_angles)) in shown.iter().enumerate() {
                for (place, &outfit) in outfits.iter().enumerate() {
                    let code = sample + place * self.n;
                    wearers.push(BodySpec {
                        betas: self.betas.clone(),
                        pose: *pose_angles,
                        outfit,
                    });
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
                        betas: self.betas.clone(),
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
        files::create_dir(&self.out)?;
        if let Some((name, image)) = skin.image.as_ref().filter(|_| self.format == Format::Obj) {
            files::write_bytes(&self.out.join(name), image)?;
            let material = format!("newmtl body\nKd 1 1 1\nmap_Kd {name}\n");
            files::write_text(&self.out.join(MATERIALS), &material)?;
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
                    dressed.colour_by_distance(self.scale / 1000.0);
                }
                if self.format == Format::Glb {
                    let performance = AnimatedBody {
                        name: line.file.trim_end_matches(".glb"),
                        code: codes.select(ndarray::Axis(0), &[index]),
                        betas: &self.betas,
                        outfit: line.outfit,
                        poses: poses.iter().map(|(_, pose)| *pose).collect(),
                        frames_per_second: self.fps,
                        shape_targets: self.shape_targets,
                        colours: skin.image.is_none().then_some(&dressed.colours[..]),
                        texture: skin.texture(),
                    };
                    performance.save(&run, self.out.join(&line.file))?;
                } else {
                    self.write(&self.out.join(&line.file), &dressed, &skin)?;
                }
                if !self.no_picture && index < MOST_PICTURES {
                    tiles.push(tile(&dressed, line, &skin)?);
                }
                progress(index + 1, wearers.len());
                Ok(())
            })
        })?;
        files::write_json_lines(&self.out.join("samples.jsonl"), &lines)?;
        let picture = self.picture(&tiles)?;
        let report = Report { files, picture, out: self.out };
        console.result(&report, || report.text(&lines))
    }

    fn file_name(&self, fields: &NameFields) -> Result<String> {
        let extension = match self.format {
            Format::Obj => "obj",
            Format::Ply => "ply",
            Format::Glb => "glb",
        };
        let name = match &self.name {
            Some(template) => names::fill(template, fields)?,
            None => names::default(fields),
        };
        Ok(format!("{name}.{extension}"))
    }

    /// Reads texture coordinates and picture.
    fn skin(&self, run: &Run) -> Result<TextureInput> {
        let Some(path) = &self.uv else { return Ok(TextureInput::default()) };
        let read = obj::read(path)?;
        let fault = |message: String| Error::message(format!("{}: {message}", path.display()));
        if read.mesh.faces != run.body().faces {
            return Err(fault(format!(
                "its {} faces are not those of the run's body ({}): texture coordinates need the \
                 same mesh",
                read.mesh.faces.len(),
                run.body().faces.len()
            )));
        }
        let uv = read.uv.ok_or_else(|| fault("has no texture coordinates (vt)".into()))?;
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
        if self.format == Format::Ply {
            ply::write(path, &dressed.mesh, Some(&dressed.colours_8_bit()))?;
        } else {
            let material = skin.image.is_some().then_some((MATERIALS, "body"));
            obj::write_with(path, &dressed.mesh, skin.uv.as_ref(), material)?;
        }
        Ok(())
    }

    fn picture(&self, tiles: &[Tile]) -> Result<Option<PathBuf>> {
        if tiles.is_empty() {
            return Ok(None);
        }
        let columns = match (self.outfit, tiles.len()) {
            // One of each, and the body beside them.
            (OutfitName::All, 5) => 5,
            (OutfitName::All, _) => Outfit::ALL.len(),
            _ => COLUMNS,
        };
        let path = self.out.join("contact_sheet.png");
        contact_sheet(tiles, columns, None)?.save(&path)?;
        Ok(Some(path))
    }
}

fn tile(dressed: &DressedMesh, line: &SampleLine, skin: &TextureInput) -> Result<Tile> {
    let label = format!("{} {} {}", line.outfit, line.sample + 1, line.pose);
    Ok(Tile { image: dressed.picture(View::ThreeQuarter, TILE, skin.on())?, label })
}

impl TextureInput {
    /// What pictures are drawn with.
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
            table.row([line.file.as_str(), line.outfit.name(), &line.pose]);
        }
        let more = match lines.len().saturating_sub(20) {
            0 => String::new(),
            more => format!("\n… and {more} more"),
        };
        format!("{}{more}\n\n{}", table.text(), self.out.display())
    }
}
