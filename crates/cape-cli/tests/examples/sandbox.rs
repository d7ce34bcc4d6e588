//! Small data under the names that the examples use.

use std::{
    env, fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::Command,
    sync::atomic::{AtomicUsize, Ordering},
};

use cape::{
    core::{
        Mesh, Outfit, PointCacheFormat, PointCacheWriter, SmplModel,
        npy::{NpzWriter, write_npy},
        obj::{self, Uv},
        ply,
        smpl::Gender,
    },
    data::{
        SequenceList, SplitSpec,
        raw::{self, RawFrame},
    },
    layer::LayerSet,
    render::Image,
    study::{RaterModel, StudyDesign},
};
use ndarray::{Array1, Array2, arr0};
use tempfile::TempDir;

use crate::{
    example::Example,
    support::{SIDES, VERTICES, pose_of, small_body},
};

/// Frames of a sequence, four of which are cut off.
const FRAMES: usize = 84;

/// Few steps of fitting.
const FEW: &str = "
[smplify]
accepted = 1e9
facing = [0.0]
stages = [{ pose = 20.0, shape = 10.0 }, {}]

[smplify.optimiser]
steps = 10

[clothed]
levels = [{ side = 64, rounds = 1, steps = 2 }]
inside = 0.0
explained = 0.0
";

/// A directory with all that the examples read.
pub(crate) struct Sandbox {
    root: TempDir,
    count: AtomicUsize,
}

impl Sandbox {
    pub(crate) fn new() -> Self {
        let sandbox = Self { root: tempfile::tempdir().unwrap(), count: AtomicUsize::new(0) };
        sandbox.captures();
        sandbox.poses();
        sandbox.run_of_each_name();
        sandbox.images();
        sandbox.scans();
        sandbox.layers();
        sandbox.study();
        sandbox
    }

    /// Runs an example, its outputs in a directory of their own.
    pub(crate) fn run(&self, example: &Example) -> Result<(), String> {
        let made = format!("made/{:03}", self.count.fetch_add(1, Ordering::Relaxed));
        fs::create_dir_all(self.at(&made)).unwrap();
        let short = example.short(&made);
        self.shell(&short).map_err(|why| example.said(&short, &why))
    }

    fn at(&self, name: &str) -> PathBuf {
        self.root.path().join(name)
    }

    fn shell(&self, line: &str) -> Result<(), String> {
        let cape = Path::new(env!("CARGO_BIN_EXE_cape")).parent().unwrap();
        let path = env::join_paths(
            [cape.to_owned(), self.at("bin")]
                .into_iter()
                .chain(env::split_paths(&env::var_os("PATH").unwrap_or_default())),
        );
        let output = Command::new("sh")
            .args(["-c", line])
            .current_dir(self.root.path())
            .env("PATH", path.unwrap())
            .env("HOME", self.at("home"))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        // A stack of rings is no person: a fit may be judged unreliable.
        if output.status.success() || said.contains("is unreliable") { Ok(()) } else { Err(said) }
    }

    #[track_caller]
    fn cape(&self, arguments: &str) {
        let line = format!("cape {arguments} --quiet");
        self.shell(&line).unwrap_or_else(|why| panic!("{line}: {why}"));
    }

    fn copy(&self, from: &str, to: &str) {
        let (from, to) = (self.at(from), self.at(to));
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        let status = Command::new("cp").arg("-r").args([from, to]).status().unwrap();
        assert!(status.success());
    }

    /// Raw and packed captures.
    fn captures(&self) {
        let split = SplitSpec {
            subjects: vec!["s0001".into()],
            outfits: Outfit::PAPER.to_vec(),
            train: sequences(&["walk", "squats"]),
            test: sequences(&["jump"]),
            ..SplitSpec::default()
        };
        write_raw(&self.at("raw"), &split, FRAMES);
        for gender in [Gender::Male, Gender::Female] {
            small_body().save(self.at("raw").join(gender.body_file())).unwrap();
            let own = SplitSpec { body: Some(gender.body_file().into()), ..split.clone() };
            let path = self.at("raw").join(raw::gender_split_file(gender));
            fs::write(path, own.to_toml().unwrap()).unwrap();
        }
        for name in ["people", "simulated"] {
            self.copy("raw", name);
        }
        let male = SplitSpec::preset("male").unwrap();
        let few = SplitSpec {
            subjects: male.subjects[..1].to_vec(),
            train: sequences(&[&male.train.sequences[0]]),
            test: sequences(&[&male.test.sequences[0]]),
            ..male
        };
        write_raw(&self.at("cape_release"), &few, 12);
        for name in ["data/cape_release", "data/cape"] {
            self.copy("cape_release", name);
        }
        self.copy("raw", "scans");
        for name in ["body.npz", "data/smpl/SMPL_MALE.pkl", "data/smpl/SMPL_FEMALE.pkl"] {
            self.copy("raw/body.npz", name);
        }
        for name in ["clothing_verts_idx.npy", "data/smpl/clothing_verts_idx.npy"] {
            self.copy("raw/clothing_verts_idx.npy", name);
        }
        let pickle = "../cape-core/fixtures/pickles/body_protocol2.pkl";
        let pickle = Path::new(env!("CARGO_MANIFEST_DIR")).join(pickle);
        fs::copy(pickle, self.at("SMPL_MALE.pkl")).unwrap();
        self.cape("data pack raw --out packed");
        self.copy("packed/stats.npz", "trainset_stats.npz");
        for name in ["data/packed/male", "data/packed/female", "quick/data"] {
            self.copy("packed", name);
        }
    }

    /// Poses, textures, and programs that examples assume.
    fn poses(&self) {
        let poses = Array2::from_shape_fn((30, 72), |(frame, i)| 0.3 * pose_of(frame)[i]);
        for name in ["dance.npy", "poses.npy"] {
            write_npy(self.at(name), &poses.mapv(|x| x as f32)).unwrap();
        }
        let row = |row: ndarray::ArrayView1<f64>| {
            row.iter().map(ToString::to_string).collect::<Vec<_>>().join(",") + "\n"
        };
        let text: String = poses.rows().into_iter().take(5).map(row).collect();
        fs::write(self.at("dance.csv"), text).unwrap();
        for directory in ["AMASS/CMU", "bin", "home/.local/share/bash-completion/completions"] {
            fs::create_dir_all(self.at(directory)).unwrap();
        }
        for name in ["amass.npz", "AMASS/CMU/walk.npz"] {
            let mut file = NpzWriter::create(self.at(name)).unwrap();
            file.add("poses", &poses).unwrap();
            file.add("trans", &Array2::<f64>::zeros((30, 3))).unwrap();
            file.add("mocap_framerate", &arr0(30.0f64)).unwrap();
            file.finish().unwrap();
        }
        let body = small_body();
        write_npy(self.at("minimal.npy"), &body.v_template).unwrap();
        let uv = Uv {
            coordinates: (0..VERTICES).map(|v| [v as f32 / VERTICES as f32, 0.5]).collect(),
            faces: body.faces.clone(),
        };
        obj::write(self.at("smpl_uv.obj"), &body.mesh(), Some(&uv)).unwrap();
        Image::new(8, 8, [90, 120, 200, 255]).unwrap().save(self.at("cloth.png")).unwrap();
        fs::write(self.at("few.toml"), FEW).unwrap();
        let tracker = self.at("bin/tracker");
        fs::write(&tracker, "#!/bin/sh\ncat dance.csv\n").unwrap();
        fs::set_permissions(&tracker, fs::Permissions::from_mode(0o755)).unwrap();
    }

    /// A run, with a prior and codes, under all names of runs.
    fn run_of_each_name(&self) {
        self.cape("train --data packed --out runs/cape --preset tiny --epochs 1 --batch 64");
        self.copy("runs/cape/config.toml", "one-epoch.toml");
        self.cape("model prior runs/cape --components 1");
        for name in ["runs/other", "runs/narrow", "runs/male", "quick/cape/seed-1/run"] {
            self.copy("runs/cape", name);
        }
        self.cape("model encode runs/cape frame:0 frame:40 --out codes");
    }

    /// Keypoints, masks and a fit.
    fn images(&self) {
        let options = "--frames 1 --size 128 --config few.toml";
        self.cape(&format!("fit benchmark image runs/cape {options} --out fits"));
        self.copy("fits/best", "fits/median");
        self.copy("fits/best/keypoints.json", "person_keypoints.json");
        self.copy("fits/best/mask.png", "person_mask.png");
        for frame in ["frame_9", "frame_10"] {
            self.copy("fits/best/keypoints.json", &format!("keypoints/{frame}_keypoints.json"));
            self.copy("fits/best/mask.png", &format!("masks/{frame}.png"));
            self.copy("fits/best/image.png", &format!("photos/{frame}.png"));
        }
        self.copy("fits/best/image.png", "person.png");
        let options = "--outfit longlong --config few.toml --out fitted";
        let inputs = "person_keypoints.json --mask person_mask.png";
        self.cape(&format!("fit image runs/cape {inputs} {options}"));
        let video = "--keypoints keypoints --masks masks --sequence --outfit longlong";
        self.cape(&format!("fit image runs/cape {video} --config few.toml --out moving"));
        self.cape("fit pose-prior AMASS/CMU --components 1 --out prior.npz");
    }

    /// A small study with answers in both files that raters' pages write.
    fn study(&self) {
        self.cape("study make runs/cape --poses 6 --a-pose 2 --matched 2 --out study");
        let design = StudyDesign::load(self.at("study")).unwrap();
        let raters = RaterModel { share: 0.4, rater_deviation: 0.2, pair_deviation: 0.2 };
        let answers = raters.answers(&design, 4, 1);
        let text = serde_json::to_vec(&answers).unwrap();
        fs::write(self.at("study/answers.jsonl"), &text).unwrap();
        fs::write(self.at("results.json"), text).unwrap();
    }

    /// Points between the vertices of a posed and slightly wider body.
    fn scans(&self) {
        let body = small_body();
        let worn = 0.05 * &body.v_template;
        let posed = body.pose(&[], &pose_of(3).map(|x| 0.1 * x), [0.0, 1.0, 0.0], Some(&worn));
        let mesh = body.mesh_with(&posed.unwrap().vertices);
        let mut points = Vec::new();
        for &face in &mesh.faces {
            let [a, b, c] = mesh.corners(face).unwrap();
            for (u, v) in [(0.2, 0.2), (0.2, 0.6), (0.6, 0.2)] {
                points.push((a + (b - a) * u + (c - a) * v).to_array());
            }
        }
        let scan = |vertices: Vec<[f32; 3]>| Mesh { vertices, faces: Vec::new() };
        for name in ["person.ply", "a.ply", "b.ply"] {
            ply::write(self.at(name), &scan(points.clone()), None).unwrap();
        }
        let upright = |[x, y, z]: [f32; 3]| [1000.0 * x, -1000.0 * z, 1000.0 * y];
        let points = scan(points.into_iter().map(upright).collect());
        obj::write(self.at("person.obj"), &points, None).unwrap();
        self.cape("fit scan runs/cape --scan a.ply --outfit longlong --pose t-pose --out a");
    }

    /// A short march in two coarse skirts, as a set, as meshes, and learned.
    fn layers(&self) {
        let options = "--exercises march --frames 8 --resolution 50 --steps 10";
        self.cape(&format!("layer synth --garment skirt --lengths 1,1.1 {options} --out skirt"));
        for name in ["moves", "materials", "fits"] {
            self.copy("skirt", &format!("report/sets/{name}"));
        }
        self.copy("skirt", "skirts");
        self.copy("skirt", "shirts");
        self.cape("layer learn skirt --components 2 --out learned");
        self.copy("learned", "fabrics");
        self.copy("learned", "sizes");
        let set = LayerSet::load(self.at("skirt")).unwrap();
        fs::create_dir(self.at("scans/skirt_01")).unwrap();
        for frame in 0..set.sequences[0].motion.frames() {
            let mesh = set.clothing(0, frame).unwrap().to_mesh();
            mesh.save(self.at(&format!("scans/skirt_01/{frame:04}.ply"))).unwrap();
        }
        let frames = "--garment scans/skirt_01/0000.ply --scan scans/skirt_01";
        self.cape(&format!("fit scan {frames} --out tracked"));
        self.exports(&set);
        let motion = &set.sequences[0].motion;
        let mut file = NpzWriter::create(self.at("scans/skirt_01.npz")).unwrap();
        file.add("poses", &motion.poses).unwrap();
        file.add("trans", &motion.translations).unwrap();
        file.add("mocap_framerate", &arr0(30.0f64)).unwrap();
        file.finish().unwrap();
    }

    /// The set's first sequence as other programs have it: a point cache in centimetres, and meshes
    /// of several objects in one directory.
    fn exports(&self, set: &LayerSet) {
        fs::create_dir(self.at("frames")).unwrap();
        let counts = [set.sequences[0].motion.frames(), set.vertices()];
        let mut cache =
            PointCacheWriter::create(self.at("skirt.pc2"), PointCacheFormat::Pc2, counts, 30.0)
                .unwrap();
        for frame in 0..set.sequences[0].motion.frames() {
            let mut mesh = set.clothing(0, frame).unwrap().to_mesh();
            mesh.save(self.at(&format!("frames/{frame}_skirt.obj"))).unwrap();
            mesh.vertices.iter_mut().for_each(|vertex| *vertex = vertex.map(|x| 100.0 * x));
            cache.push(&mesh.vertices).unwrap();
            mesh.save(self.at("skirt.obj")).unwrap();
        }
        cache.finish().unwrap();
    }
}

fn sequences(names: &[&str]) -> SequenceList {
    let sequences = names.iter().map(ToString::to_string).collect();
    SequenceList { sequences, exclude: Vec::new() }
}

/// Raw captures of the small body.
fn write_raw(root: &Path, split: &SplitSpec, frames: usize) {
    let body = small_body();
    fs::create_dir_all(root).unwrap();
    body.save(root.join("body.npz")).unwrap();
    let clothing = Array1::from_iter((2 * SIDES..9 * SIDES).map(|vertex| vertex as i64));
    write_npy(root.join("clothing_verts_idx.npy"), &clothing).unwrap();
    fs::write(root.join("split.toml"), split.to_toml().unwrap()).unwrap();
    for subject in &split.subjects {
        raw::write_minimal(root, subject, &body.v_template).unwrap();
        let sequences = split.train.sequences.iter().chain(&split.test.sequences);
        for (index, sequence) in sequences.enumerate() {
            for &outfit in &split.outfits {
                for number in 1..=frames {
                    let frame = frame(&body, outfit, 10 * index + number);
                    raw::write_frame(root, subject, outfit, sequence, number, &frame).unwrap();
                }
            }
        }
    }
}

fn frame(body: &SmplModel, outfit: Outfit, moment: usize) -> RawFrame {
    let pose = pose_of(moment);
    let displacement = Array2::from_shape_fn((VERTICES, 3), |(vertex, axis)| {
        let phase = vertex as f64 * 0.4 + axis as f64;
        0.01 * phase.sin() * pose[3 + axis] + 0.004 * outfit.stream() as f64
    });
    let v_cano = &body.v_template + &displacement;
    let posed = body.pose(&[], &pose, [0.0; 3], Some(&displacement)).unwrap().vertices;
    RawFrame { v_posed: posed, v_cano, pose, transl: [0.0; 3] }
}
