use std::path::{Path, PathBuf};

use cape_core::{Outfit, obj, parse_device, ply};
use cape_render::{Tile, View, contact_sheet};
use cape_train::Run;
use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::{
    arguments::{Global, at_least_one},
    console::Console,
    dressed::{Dressed, Request, dress},
    error::{Error, Result},
    files,
    pose::poses,
    table::Table,
};

/// Bodies that a contact sheet shows at most.
const MOST_PICTURES: usize = 32;
/// Bodies in a row of it, if there is one outfit.
const COLUMNS: usize = 6;

/// Dress bodies in clothes drawn from a trained model.
///
/// Draws codes from the prior, decodes them under a pose and an outfit, and writes posed meshes,
/// samples.jsonl with what each was made from, and contact_sheet.png. The same code is used for all
/// outfits and all poses of a file.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape sample run --outfit all --pose a-pose --out samples\n  \
                        cape sample run --outfit longlong --pose dance.npy --n 3 --betas 1,-0.5 \
                        --format ply --out samples")]
pub(crate) struct Sample {
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
    /// Kind of mesh file; .ply comes with colours.
    #[arg(long, value_enum, default_value_t = Format::Obj)]
    format: Format,
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
}

/// A line of samples.jsonl.
#[derive(Debug, Serialize)]
struct Line {
    file: String,
    outfit: Outfit,
    pose: String,
    axis_angles: Vec<f32>,
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

impl Sample {
    pub(crate) fn run(self, global: &Global, console: Console) -> Result {
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
        let seed = global.seed.unwrap_or(1);
        let codes = run.sample_codes(self.n, seed);
        let (mut requests, mut lines) = (Vec::new(), Vec::new());
        for code in 0..self.n {
            for (frame, (pose_name, pose)) in poses.iter().enumerate() {
                for outfit in self.outfit.outfits() {
                    requests.push(Request { outfit, pose: *pose, code });
                    lines.push(Line {
                        file: self.file_name(outfit, code, (poses.len() > 1).then_some(frame)),
                        outfit,
                        pose: pose_name.clone(),
                        axis_angles: pose.to_vec(),
                        betas: self.betas.clone(),
                        seed,
                        sample: code,
                        code: codes.row(code).to_vec(),
                    });
                }
            }
        }
        files::create_dir(&self.out)?;
        let mut tiles = Vec::new();
        console.while_showing("sample", "bodies", |progress| {
            dress(&run, &codes, &self.betas, &requests, |index, dressed| {
                let line = &lines[index];
                self.write(&self.out.join(&line.file), &dressed)?;
                if !self.no_picture && index < MOST_PICTURES {
                    tiles.push(tile(&dressed, line)?);
                }
                progress(index + 1, requests.len());
                Ok(())
            })
        })?;
        let mut text = String::new();
        for line in &lines {
            let json = serde_json::to_string(line)
                .map_err(|error| Error::message(format!("samples.jsonl: {error}")))?;
            text += &json;
            text.push('\n');
        }
        files::write_text(&self.out.join("samples.jsonl"), &text)?;
        let picture = self.picture(&tiles)?;
        let report = Report {
            files: lines.iter().map(|line| line.file.clone()).collect(),
            picture,
            out: self.out,
        };
        console.result(&report, || report.text(&lines))
    }

    fn file_name(&self, outfit: Outfit, code: usize, frame: Option<usize>) -> String {
        let extension = match self.format {
            Format::Obj => "obj",
            Format::Ply => "ply",
        };
        let frame = frame.map_or(String::new(), |frame| format!("_{frame:05}"));
        format!("{outfit}_{:03}{frame}.{extension}", code + 1)
    }

    fn write(&self, path: &Path, dressed: &Dressed) -> Result {
        match self.format {
            Format::Obj => obj::write(path, &dressed.mesh, None)?,
            Format::Ply => ply::write(path, &dressed.mesh, Some(&dressed.colours_8_bit()))?,
        }
        Ok(())
    }

    fn picture(&self, tiles: &[Tile]) -> Result<Option<PathBuf>> {
        if tiles.is_empty() {
            return Ok(None);
        }
        let columns = if self.outfit == OutfitName::All { Outfit::ALL.len() } else { COLUMNS };
        let path = self.out.join("contact_sheet.png");
        contact_sheet(tiles, columns, None)?.save(&path)?;
        Ok(Some(path))
    }
}

fn tile(dressed: &Dressed, line: &Line) -> Result<Tile> {
    let label = format!("{} {} {}", line.outfit, line.sample + 1, line.pose);
    Ok(Tile { image: dressed.picture(View::ThreeQuarter, 320, 420)?, label })
}

impl Report {
    fn text(&self, lines: &[Line]) -> String {
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
