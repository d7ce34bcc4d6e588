use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    str::FromStr,
    time::Instant,
};

use cape_core::{
    BodyMotion, DirectoryLock, list_files,
    motion::read_motion,
    smpl::{Gender, SubjectBodies},
};
use cape_data::{SequenceList, SplitSpec};
use cape_synth::SynthSpec;
use cape_wardrobe::{
    PLAN_FILE, QUALITY_FILE, Shard, SimulatedCaptures, TakeRecord, WardrobeOptions,
};
use clap::Args;
use serde::Serialize;

use super::tree_files::TreeFiles;
use crate::{
    console::{Console, seconds},
    error::{Error, Result},
    files,
    motion_source::MotionFileArgs,
    options::{at_least_one, non_negative, positive},
    table::Table,
};

/// Options of simulated clothing.
#[derive(Debug, Args)]
#[command(next_help_heading = "Simulated clothing")]
pub(super) struct SimulatedArgs {
    /// Takes of each motion, each dressed afresh [default: 1].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    takes: Option<usize>,
    /// Motion file, or directory of motion files, recorded besides --motions.
    #[arg(long, value_name = "PATH")]
    motion: Option<PathBuf>,
    #[command(flatten)]
    reading: MotionFileArgs,
    /// Length of the garments' edges, mm [default: 25].
    #[arg(long, value_name = "MM", value_parser = positive)]
    resolution: Option<f64>,
    /// Standard deviation of a smooth registration error, mm [default: 0].
    #[arg(long, value_name = "MM", value_parser = non_negative)]
    noise: Option<f64>,
    /// Share of the cloth's sliding along the skin that vertices follow, 0 to 1 [default: 0.1].
    #[arg(long, value_name = "X", value_parser = non_negative)]
    sliding: Option<f64>,
    /// Share of the takes to simulate, such as 2/8, on several machines.
    #[arg(long, value_name = "I/N")]
    shard: Option<ShardChoice>,
    /// Estimate time and size from one short take, and write nothing.
    #[arg(long)]
    dry_run: bool,
}

/// A share of the takes by its number, from 1.
#[derive(Debug, Clone, Copy)]
struct ShardChoice(Shard);

impl FromStr for ShardChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').map(|(i, n)| (i.parse::<usize>(), n.parse::<usize>()));
        match numbers {
            Some((Ok(index), Ok(of))) if (1..=of).contains(&index) => {
                Ok(Self(Shard { index: index - 1, of }))
            }
            _ => Err("expected I/N with I from 1 to N, such as 2/8".into()),
        }
    }
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    takes: usize,
    frames: usize,
    vertices: usize,
    clothing_vertices: usize,
    seconds: f64,
    quality: Option<QualitySummary>,
}

/// Largest and mean values over takes.
#[derive(Debug, Serialize)]
struct QualitySummary {
    penetration_mm: f64,
    mean_strain: f64,
    crossings: usize,
    turned: f64,
    intersecting: f64,
    displacement_mm: f64,
}

#[derive(Debug, Serialize)]
struct Estimate {
    takes: usize,
    frames: usize,
    bytes: u64,
    seconds_per_take: f64,
    seconds: f64,
    threads: usize,
}

impl SimulatedArgs {
    /// Returns an error if an option of simulated clothing is given.
    pub(super) fn require_absent(&self) -> Result {
        let given = [
            ("--takes", self.takes.is_some()),
            ("--motion", self.motion.is_some()),
            ("--resolution", self.resolution.is_some()),
            ("--noise", self.noise.is_some()),
            ("--sliding", self.sliding.is_some()),
            ("--shard", self.shard.is_some()),
            ("--dry-run", self.dry_run),
        ];
        match given.iter().find(|(_, given)| *given) {
            Some((name, _)) => {
                Err(Error::message(format!("{name}: add --clothes simulated, which it belongs to")))
            }
            None => Ok(()),
        }
    }

    pub(super) fn run(
        &self,
        bodies: SubjectBodies<'_>,
        spec: SynthSpec,
        out: PathBuf,
        console: Console,
    ) -> Result {
        let start = Instant::now();
        let defaults = WardrobeOptions::default();
        let options = WardrobeOptions {
            takes: self.takes.unwrap_or(defaults.takes),
            resolution: self.resolution.map_or(defaults.resolution, |mm| 1e-3 * mm),
            noise: self.noise.map_or(defaults.noise, |mm| 1e-3 * mm),
            sliding: self.sliding.unwrap_or(defaults.sliding),
            recordings: self.recordings(bodies)?,
            ..defaults
        };
        if self.dry_run {
            return estimate(bodies, spec, options, self.shard(), console);
        }
        let captures = SimulatedCaptures::new(bodies, spec, options)?;
        // A process that was killed at once has locked the directory, but not written the plan.
        if !out.join(PLAN_FILE).exists() && !DirectoryLock::was_in(&out) {
            files::require_empty(&out)?;
        }
        let records = console.while_showing("simulate", "takes", |progress| {
            captures.write(&out, self.shard(), progress)
        })?;
        let layout = TreeFiles::write_splits(&out, captures.groups(), &split_of(&captures))?;
        let report = Report {
            takes: records.len(),
            frames: records.iter().map(|record| record.frames).sum(),
            vertices: captures.vertices(),
            clothing_vertices: captures.clothing_vertices().len(),
            seconds: start.elapsed().as_secs_f64(),
            quality: summary(&records),
            out,
        };
        console.result(&report, || report.text(&layout))
    }

    fn shard(&self) -> Shard {
        self.shard.map_or_else(Shard::default, |shard| shard.0)
    }

    /// Motions of the file or directory, by name, with the pelvis of the (male) body's mean shape.
    fn recordings(&self, bodies: SubjectBodies<'_>) -> Result<Vec<(String, BodyMotion)>> {
        let Some(path) = &self.motion else { return Ok(Vec::new()) };
        let body = bodies.of(Some(Gender::Male))?;
        let paths = if path.is_dir() { motion_files(path)? } else { vec![path.clone()] };
        let read = |path: &PathBuf| {
            let file = read_motion(path, &self.reading.options())?;
            Ok((motion_name(path), file.motion_of(body, &[], None)?))
        };
        paths.iter().map(read).collect()
    }
}

/// Motion files of a directory and its subdirectories, as AMASS has them.
fn motion_files(directory: &Path) -> Result<Vec<PathBuf>> {
    let of_kind = |kind: &str, path: &Path| {
        path.extension().is_some_and(|found| found.eq_ignore_ascii_case(kind))
    };
    let mut found = list_files(directory, |path| {
        ["npz", "pkl", "smpl"].iter().any(|kind| of_kind(kind, path))
            && !path.file_stem().is_some_and(|stem| stem == "shape" || stem == "neutral_stagei")
    })?;
    for directory in list_files(directory, Path::is_dir)? {
        found.extend(motion_files(&directory)?);
    }
    Ok(found)
}

/// Name of a motion in sequence names: that of its file, with letters, digits and `-` only.
fn motion_name(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    stem.trim_end_matches("_poses")
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
        .collect()
}

/// Least number of training motions of which the last is for validation.
const MOTIONS_TO_VALIDATE: usize = 4;

/// The split into training and test motions; recordings are for training. The last of several training
/// motions is for validation.
fn split_of(captures: &SimulatedCaptures) -> SplitSpec {
    let spec = captures.spec();
    let is_test = |motion: usize| spec.motions.get(motion).is_some_and(|motion| motion.is_test());
    let motions = captures.takes().into_iter().map(|take| take.motion);
    let training: BTreeSet<usize> = motions.filter(|&motion| !is_test(motion)).collect();
    let validation = training.last().filter(|_| training.len() >= MOTIONS_TO_VALIDATE);
    let mut lists = [const { SequenceList { sequences: Vec::new(), exclude: Vec::new() } }; 3];
    for take in captures.takes() {
        let place = match take.motion {
            motion if is_test(motion) => 1,
            motion if validation == Some(&motion) => 2,
            _ => 0,
        };
        let name = captures.sequence(&take);
        let list = &mut lists[place].sequences;
        if !list.contains(&name) {
            list.push(name);
        }
    }
    let [train, test, validation] = lists;
    SplitSpec {
        subjects: spec.subject_names(),
        outfits: spec.outfits.clone(),
        train,
        test,
        validation,
        ..SplitSpec::default()
    }
}

/// Time and size of a data set, from one take of two frames.
fn estimate(
    bodies: SubjectBodies<'_>,
    spec: SynthSpec,
    options: WardrobeOptions,
    shard: Shard,
    console: Console,
) -> Result {
    let whole = SimulatedCaptures::new(bodies, spec.clone(), options.clone())?;
    let short = SynthSpec { frames_per_sequence: 2, ..spec };
    let short = SimulatedCaptures::new(bodies, short, options)?;
    let all = short.takes();
    let mine = all.iter().skip(shard.index).step_by(shard.of);
    let Some(first) = mine.clone().next() else {
        return Err(Error::message("no takes: add motions, or ask for fewer shards"));
    };
    let start = Instant::now();
    short.simulate(first)?;
    let per_frame = start.elapsed().as_secs_f64() / short.simulated_frames() as f64;
    let seconds_per_take = per_frame * whole.simulated_frames() as f64;
    let (takes, threads) = (mine.count(), rayon::current_num_threads());
    let frames = takes * whole.spec().frames_per_sequence;
    let estimate = Estimate {
        takes,
        frames,
        // Two arrays of vertices, pose and translation.
        bytes: (frames * (whole.vertices() * 24 + 75 * 8 + 1000)) as u64,
        seconds_per_take,
        seconds: seconds_per_take * (takes as f64 / threads as f64).ceil(),
        threads,
    };
    console.result(&estimate, || {
        format!(
            "{} takes of {} frames, {:.1} GB, about {} on {} threads ({} a take)",
            estimate.takes,
            whole.spec().frames_per_sequence,
            1e-9 * estimate.bytes as f64,
            seconds(estimate.seconds),
            estimate.threads,
            seconds(estimate.seconds_per_take)
        )
    })
}

fn summary(records: &[TakeRecord]) -> Option<QualitySummary> {
    let takes = records.len() as f64;
    let largest = |of: fn(&TakeRecord) -> f64| records.iter().map(of).fold(0.0, f64::max);
    let mean = |of: fn(&TakeRecord) -> f64| records.iter().map(of).sum::<f64>() / takes;
    (!records.is_empty()).then(|| QualitySummary {
        penetration_mm: 1e3 * largest(|record| record.quality.simulation.penetration),
        mean_strain: mean(|record| record.quality.simulation.mean_strain),
        crossings: records.iter().map(|r| r.quality.simulation.crossings).max().unwrap_or(0),
        turned: largest(|record| record.quality.turned),
        intersecting: mean(|record| record.quality.intersecting),
        displacement_mm: 1e3 * mean(|record| record.quality.displacement),
    })
}

impl Report {
    fn text(&self, layout: &TreeFiles) -> String {
        let mut table = Table::default();
        let mut row = |name: &str, value: String| table.row([name.to_owned(), value]);
        row("takes", self.takes.to_string());
        row("frames", self.frames.to_string());
        row("vertices", self.vertices.to_string());
        row("clothing vertices", self.clothing_vertices.to_string());
        if let Some(quality) = &self.quality {
            let QualitySummary { mean_strain, turned, intersecting, .. } = quality;
            row("displacement, mean", format!("{:.1} mm", quality.displacement_mm));
            row("penetration, largest", format!("{:.1} mm", quality.penetration_mm));
            row("strain, mean", format!("{:.1} %", 1e2 * mean_strain));
            row("cloth through cloth", format!("{} edges at most", quality.crossings));
            row("turned triangles", format!("{:.2} % at most", 1e2 * turned));
            row("self-intersections", format!("{:.2} % on average", 1e2 * intersecting));
        }
        row("time", seconds(self.seconds));
        format!("{}\n\n{}", table.text(), layout.text(&self.out, QUALITY_FILE))
    }
}
