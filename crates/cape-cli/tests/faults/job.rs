//! Commands that write directories, small enough to be run many times.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Child, Stdio},
    time::{Duration, Instant},
};

use serde_json::Value;

use crate::support::{FEW_STEPS, Packed, Ran, cape, contents, remove_seconds, trained};

/// A command line that writes `@/out`; `@` is a directory, `%` a trained run.
pub(crate) struct Job {
    pub(crate) name: &'static str,
    line: &'static str,
    /// Number of frames of a raw sequence.
    frames: usize,
    /// True for a file of `out` that is complete and will not be written again.
    finished: fn(&str) -> bool,
}

const NEVER: fn(&str) -> bool = |_| false;

/// The jobs that take a second or two, those without simulations, and with `CAPE_FAULTS` all of them.
pub(crate) fn quick_jobs() -> impl Iterator<Item = &'static Job> {
    let all = std::env::var_os("CAPE_FAULTS").is_some();
    JOBS.iter()
        .filter(move |job| all || !job.name.contains("simulated") && job.name != "layer synth")
}

pub(crate) const JOBS: [Job; 7] = [
    Job {
        name: "data synth",
        line: "data synth --out @/out --subjects 1 --frames-per-sequence 2 --motions simple,squats \
               --outfits longlong",
        frames: 5,
        finished: NEVER,
    },
    Job {
        name: "data synth --clothes simulated",
        line: "data synth --clothes simulated --subjects 1 --outfits shortshort --motions simple \
               --frames-per-sequence 1 --resolution 50 --out @/out",
        frames: 5,
        finished: |name| name.starts_with("takes/"),
    },
    Job { name: "data pack", line: "data pack @/raw --out @/out", frames: 60, finished: NEVER },
    Job {
        name: "train",
        line: "train --data @/packed --out @/out --preset tiny --epochs 8 --batch 4 --checkpoint-steps 3 \
               --keep 2",
        frames: 8,
        finished: NEVER,
    },
    Job {
        name: "table2",
        line: "table2 --data @/packed --out @/out --preset tiny --epochs 2 --rows mean,pca,coma-4,cape",
        frames: 8,
        finished: |name| name.ends_with("result.json"),
    },
    Job {
        name: "fit image",
        line: "fit image % --keypoints @/poses --masks @/masks --outfit longlong --config @/few.toml \
               --out @/out",
        frames: 8,
        finished: |name| name.ends_with("fit.json"),
    },
    Job {
        name: "layer synth",
        line: "layer synth --garment skirt --exercises march --subjects=-1,1 --frames 2 --resolution 50 \
               --out @/out --threads 1",
        frames: 5,
        finished: |name| name.starts_with("sequences/"),
    },
];

/// A job with its inputs, and what it writes undisturbed.
pub(crate) struct Bench<'a> {
    pub(crate) job: &'a Job,
    pub(crate) place: Packed,
    pub(crate) expected: BTreeMap<String, Vec<u8>>,
    /// Time of the undisturbed command.
    pub(crate) took: Duration,
}

impl<'a> Bench<'a> {
    pub(crate) fn new(job: &'a Job) -> Self {
        let place = Packed::with_frames(job.frames);
        if job.line.contains('%') {
            people(&place);
        }
        let mut bench = Self { job, place, expected: BTreeMap::new(), took: Duration::ZERO };
        let start = Instant::now();
        bench.run().succeeded();
        bench.took = start.elapsed();
        bench.expected = bench.written();
        assert!(!bench.expected.is_empty());
        bench.clear();
        bench
    }

    /// Words of the command that starts the job, or goes on with it.
    pub(crate) fn words(&self) -> Vec<String> {
        let resumed = self.job.name == "train" && self.place.at("out/config.toml").exists();
        let line = if resumed { "train --out @/out --resume" } else { self.job.line };
        let run = trained().at("run").display().to_string();
        let root = self.place.root().display().to_string();
        line.split_whitespace().map(|word| word.replace('@', &root).replace('%', &run)).collect()
    }

    pub(crate) fn run(&self) -> Ran {
        cape(self.words()).output().unwrap().into()
    }

    /// Runs the job to its end. One that was complete before it was killed may say that its directory is
    /// there.
    #[track_caller]
    pub(crate) fn finish(&self) {
        let ran = self.run();
        let complete = ran.code == Some(1) && ran.err.contains("already exists");
        assert!(ran.code == Some(0) || complete, "{}: {}", self.job.name, ran.err);
    }

    pub(crate) fn start(&self) -> Child {
        cape(self.words()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    /// Starts the job and kills it after `time`.
    pub(crate) fn kill_after(&self, time: Duration) {
        let mut child = self.start();
        std::thread::sleep(time);
        child.kill().unwrap();
        child.wait().unwrap();
    }

    pub(crate) fn written(&self) -> BTreeMap<String, Vec<u8>> {
        lasting(&self.place.at("out"))
    }

    /// Contents of the files that are finished, and the times of their last change.
    pub(crate) fn finished(&self) -> Vec<(PathBuf, std::time::SystemTime)> {
        let root = self.place.at("out");
        if !root.exists() {
            return Vec::new();
        }
        let files = contents(&root).into_iter().map(|(path, _)| path);
        let done = files.filter(|path| (self.job.finished)(&path.to_string_lossy()));
        let done = done.filter(|path| !hidden(path));
        done.map(|path| (path.clone(), modified(&root.join(path)))).collect()
    }

    /// Asserts that the directory is what an undisturbed command writes, and that nothing is beside it.
    #[track_caller]
    pub(crate) fn assert_as_expected(&self, after: &str) {
        let name = self.job.name;
        let found = self.written();
        let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&found), names(&self.expected), "{name}: {after}");
        for (file, bytes) in &found {
            assert!(*bytes == self.expected[file], "{name}: {after}: {file} differs");
        }
        let leftover = |path: &Path| path.to_string_lossy().contains(".tmp");
        let left: Vec<_> = contents(&self.place.at("out"))
            .into_iter()
            .filter(|(path, _)| leftover(path))
            .collect();
        assert!(left.is_empty(), "{name}: {after}: {}", left[0].0.display());
        let beside =
            fs::read_dir(self.place.root()).unwrap().map(|entry| entry.unwrap().file_name());
        let beside: Vec<_> =
            beside.filter(|file| file.to_string_lossy().starts_with(".out")).collect();
        assert!(beside.is_empty(), "{name}: {after}: {beside:?}");
    }

    /// Removes what the job wrote.
    pub(crate) fn clear(&self) {
        for entry in fs::read_dir(self.place.root()).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if name == "out" || name.starts_with(".out") {
                if path.is_dir() {
                    fs::remove_dir_all(path).unwrap();
                } else {
                    fs::remove_file(path).unwrap();
                }
            }
        }
    }
}

fn modified(path: &Path) -> std::time::SystemTime {
    fs::metadata(path).unwrap().modified().unwrap()
}

fn hidden(path: &Path) -> bool {
    path.components().any(|part| part.as_os_str().to_string_lossy().starts_with('.'))
}

/// Files below `root` by name, without hidden ones, TensorBoard's events, which have times, and times in
/// others.
pub(crate) fn lasting(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = contents(root).into_iter().filter(|(path, _)| !hidden(path));
    let files = files.map(|(path, bytes)| (path.to_string_lossy().into_owned(), bytes));
    files.filter_map(|(name, bytes)| Some((name.clone(), timeless(&name, bytes)?))).collect()
}

fn timeless(name: &str, bytes: Vec<u8>) -> Option<Vec<u8>> {
    let end = Path::new(name).extension().unwrap_or_default().to_string_lossy().into_owned();
    // On a disk of its own the directory has another path.
    let text = || String::from_utf8(bytes.clone()).unwrap().replace("/disk/out", "/out");
    let without = |text: &str| {
        let mut value: Value = serde_json::from_str(text).unwrap();
        remove_seconds(&mut value);
        value.to_string()
    };
    Some(match end.as_str() {
        "json" => without(&text()).into_bytes(),
        "txt" if name.ends_with("files.txt") => {
            let text = text();
            let mut lines: Vec<&str> = text.lines().collect();
            lines.sort_unstable();
            lines.join("\n").into_bytes()
        }
        "jsonl" => text().lines().map(|line| without(line) + "\n").collect::<String>().into_bytes(),
        _ if name.contains("tfevents") => return None,
        // Of files with times.
        _ if name.ends_with("SHA256SUMS") || name.starts_with("table2.") || end == "html" => {
            Vec::new()
        }
        _ => bytes,
    })
}

/// Keypoints and masks of one person in three images.
fn people(place: &Packed) {
    let run = trained().at("run").display().to_string();
    fs::write(place.at("few.toml"), FEW_STEPS).unwrap();
    let options = "--frames 1 --size 128 --config @/few.toml --out @/seen";
    place.run(&format!("fit benchmark image {run} {options}")).succeeded();
    for directory in ["poses", "masks"] {
        fs::create_dir(place.at(directory)).unwrap();
    }
    for name in ["f1", "f2", "f3"] {
        let to = |path: String| place.at(&path);
        fs::copy(place.at("seen/best/keypoints.json"), to(format!("poses/{name}_keypoints.json")))
            .unwrap();
        fs::copy(place.at("seen/best/mask.png"), to(format!("masks/{name}.png"))).unwrap();
    }
}
