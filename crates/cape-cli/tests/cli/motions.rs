//! Motions as other programs write them, in every command that reads poses.

use std::{f64::consts::FRAC_PI_2, fs, path::Path, sync::OnceLock};

use cape::{
    core::{
        Mesh,
        npy::{NpyHeader, NpzWriter, write_npy},
    },
    layer::LayerSet,
};
use ndarray::{Array1, Array2, Array3, Array4, ArrayRef, Axis, Dimension, concatenate, s};
use tempfile::TempDir;

use crate::{
    files::glb,
    layer::skirt,
    support::{Packed, Ran, cape, run, trained},
};

/// Frames of the movement of [`poses`].
const FRAMES: usize = 3;
const OPTIONS: &str = "--outfit longlong --code mean --json";

/// A body that stands with y up and sways, `[FRAMES, 72]`.
fn poses() -> Array2<f64> {
    let mut poses = Array2::zeros((FRAMES, 72));
    for frame in 0..FRAMES {
        poses[(frame, 14)] = 0.2 * frame as f64;
        poses[(frame, 27)] = 0.1;
    }
    poses
}

/// AMASS: z is up, 120 frames per second, SMPL+H, 16 betas, a way along -y of 1.2 m/s.
struct Amass {
    frames: usize,
    /// Numbers of a pose.
    width: usize,
    rate: &'static str,
    /// Rows and columns of the betas; one row is a vector.
    betas: [usize; 2],
}

impl Default for Amass {
    fn default() -> Self {
        Self { frames: 24, width: 156, rate: "mocap_framerate", betas: [1, 16] }
    }
}

impl Amass {
    fn save(&self, path: &Path) {
        let mut poses = Array2::<f64>::zeros((self.frames, self.width));
        poses.column_mut(0).fill(FRAC_PI_2);
        let way = Array2::from_shape_fn((self.frames, 3), |(frame, axis)| match axis {
            1 => -0.01 * frame as f64,
            _ => 0.0,
        });
        let mut betas = Array2::<f64>::zeros(self.betas);
        betas.column_mut(0).fill(0.5);
        let mut file = NpzWriter::create(path).unwrap();
        file.add("poses", &poses).unwrap();
        file.add("trans", &way).unwrap();
        if self.betas[0] == 1 {
            file.add("betas", &betas.row(0).to_owned()).unwrap();
        } else {
            file.add("betas", &betas).unwrap();
        }
        file.add("dmpls", &Array2::<f64>::zeros((self.frames, 8))).unwrap();
        file.add(self.rate, &ndarray::arr0(120.0)).unwrap();
        file.add_text("gender", "male").unwrap();
        file.finish().unwrap();
    }
}

/// Lowest and highest coordinates of a mesh along each axis.
fn bounds(path: &Path) -> [[f32; 3]; 2] {
    Mesh::load(path).unwrap().bounding_box().unwrap()
}

/// Report and remarks of `cape animate`.
fn animate(data: &Packed, motion: &Path, options: &str, out: &Path) -> (serde_json::Value, String) {
    let line = format!("animate {} {OPTIONS} {options}", data.at("run").display());
    let mut words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
    words.extend(["--motion".to_owned(), motion.display().to_string()]);
    words.extend(["--out".to_owned(), out.display().to_string()]);
    let ran: Ran = cape(&words).output().unwrap().into();
    let said = ran.err.clone();
    (ran.json(), said)
}

#[test]
fn a_body_of_amass_stands_walks_and_takes_its_time() {
    let (data, place) = (trained(), tempfile::tempdir().unwrap());
    let at = |name: &str| place.path().join(name);
    Amass::default().save(&at("walk.npz"));
    let (report, said) = animate(data, &at("walk.npz"), "--format ply", &at("meshes"));
    assert_eq!((&report["frames"], &report["frames_per_second"]), (&24.into(), &120.0.into()));
    assert_eq!(report["betas"], serde_json::json!([0.5, 0.0]));
    for part in ["30 hand joints, 8 soft-tissue", "gender `male`", "first 2 of 16 betas"] {
        assert!(said.contains(part), "`{part}` is not in:\n{said}");
    }
    let [first, last] =
        ["frame-00000.ply", "frame-00023.ply"].map(|name| bounds(&at("meshes").join(name)));
    // It stands along y, and walks along z, which is to its front.
    let [width, height, depth] = [0, 1, 2].map(|k| first[1][k] - first[0][k]);
    assert!(height > 1.5 && width < 0.6 && depth < 0.6, "{first:?}");
    for (axis, way) in [(0, 0.0), (1, 0.0), (2, 0.23)] {
        assert!((last[0][axis] - first[0][axis] - way).abs() < 1e-4, "{first:?} {last:?}");
    }
    // At another rate for as long; in an axis that is named, as it is told.
    let (report, _) = animate(data, &at("walk.npz"), "--format smpl --fps 30", &at("slow"));
    assert_eq!((&report["frames"], &report["frames_per_second"]), (&6.into(), &30.0.into()));
    animate(data, &at("walk.npz"), "--format ply --fps 30 --up y", &at("lying"));
    let lying = bounds(&at("lying").join("frame-00000.ply"));
    assert!(lying[1][2] - lying[0][2] > 1.5, "{lying:?}");
    // A .smpl file is a motion again, with y up and at its rate.
    let (report, said) = animate(data, &at("slow/animation.smpl"), "--format ply", &at("again"));
    assert_eq!((&report["frames"], &report["frames_per_second"]), (&6.into(), &30.0.into()));
    assert!(!said.contains("left out") && !said.contains("taken as up"), "{said}");
    let again = bounds(&at("again/frame-00000.ply"));
    assert!((again[1][1] - first[1][1]).abs() < 1e-4, "{again:?} {first:?}");
}

#[test]
fn long_motions_become_gltf_with_few_targets() {
    let (data, place) = (trained(), tempfile::tempdir().unwrap());
    let at = |name: &str| place.path().join(name);
    let motion = Amass { frames: 1200, ..Amass::default() };
    motion.save(&at("long.npz"));
    for (options, most) in [("", 16), ("--every 100", 13)] {
        let out = at(&format!("glb{most}"));
        let (report, _) = animate(data, &at("long.npz"), &format!("--format glb {options}"), &out);
        let document = glb(&out.join("animation.glb"));
        let targets = document["meshes"][0]["weights"].as_array().unwrap().len();
        assert_eq!(report["keyframes"], targets);
        assert!((1..=most).contains(&targets), "{targets}");
        assert!(report["error_mm"].as_f64().unwrap() <= 1.0, "{report}");
        let samplers = document["animations"][0]["samplers"].as_array().unwrap();
        let last = samplers.iter().map(|sampler| {
            let input = sampler["input"].as_u64().unwrap() as usize;
            document["accessors"][input]["max"][0].as_f64().unwrap()
        });
        let seconds = last.fold(0.0, f64::max);
        assert!((seconds - 1199.0 / 120.0).abs() < 1e-4, "{seconds}");
    }
}

#[test]
fn layers_follow_motions_of_amass() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let shown = |name: &str| at(name).display().to_string();
    let set = LayerSet::load(skirt()).unwrap();
    let known = &set.sequences[0];
    // Meshes in the axes of the motion, y up.
    fs::create_dir(at("meshes")).unwrap();
    for frame in 0..known.frames() {
        let mesh = set.clothing(0, frame).unwrap().to_mesh();
        mesh.save(at("meshes").join(format!("{frame:04}.ply"))).unwrap();
    }
    for (width, rate) in [(156, "mocap_framerate"), (165, "mocap_frame_rate")] {
        let name = format!("captured-{width}");
        let mut wide = Array2::<f64>::zeros((known.frames(), width));
        let own = known.motion.poses.slice(s![.., ..66]);
        wide.slice_mut(s![.., ..66]).assign(&own);
        let mut file = NpzWriter::create(at(&format!("{name}.npz"))).unwrap();
        file.add("poses", &wide).unwrap();
        file.add("trans", &known.motion.translations).unwrap();
        file.add("betas", &Array1::<f64>::zeros(16)).unwrap();
        file.add(rate, &ndarray::arr0(120.0)).unwrap();
        file.finish().unwrap();
        let ran = run([
            "layer",
            "import",
            &shown("meshes"),
            &shown(&format!("{name}.npz")),
            "--set",
            &shown(&name),
            "--name",
            "walk",
        ]);
        let said = ran.err.clone();
        ran.succeeded();
        for part in ["first 10 of 16 betas", "30 hand joints", "stands along y"] {
            assert!(width == 165 || said.contains(part), "`{part}` is not in:\n{said}");
        }
        let imported = LayerSet::load(at(&name)).unwrap();
        let found = &imported.sequences[0];
        assert_eq!((found.motion.frame_rate, found.betas.len()), (120.0, 10));
        assert_eq!(found.clothing.dim(), known.clothing.dim());
        assert_eq!(found.motion.poses.slice(s![.., ..66]), own);
        assert!(found.motion.poses.slice(s![.., 66..]).iter().all(|&angle| angle == 0.0));
    }

    // Predictions over 16 betas, over betas per frame, and over those of the option are the same.
    run([
        "layer",
        "learn",
        &skirt().display().to_string(),
        "--components",
        "3",
        "--out",
        &shown("learned"),
    ])
    .succeeded();
    let of = |motion: &str, options: &[&str], out: &str| {
        let layer = shown("learned/layer.npz");
        let motion = shown(motion);
        let out = shown(out);
        let mut words = vec!["layer", "predict", &layer, "--motion", &motion, "--out", &out];
        words.extend(["--fps", "30"]);
        words.extend(options);
        let ran = run(&words);
        let said = ran.err.clone();
        ran.succeeded();
        said
    };
    Amass { frames: 9, ..Amass::default() }.save(&at("one.npz"));
    Amass { frames: 9, betas: [9, 10], ..Amass::default() }.save(&at("each.npz"));
    assert!(of("one.npz", &[], "one").contains("the first 10 of 16 betas are used"));
    assert!(of("each.npz", &[], "each").contains("betas in 9 rows: their mean is used"));
    of("one.npz", &["--betas", "0.5"], "option");
    let frame = |out: &str| fs::read(at(out).join("frame-00002.ply")).unwrap();
    // Nine frames at 120 are three at 30 frames per second.
    assert!(!at("one/frame-00003.ply").exists());
    assert_eq!((frame("one"), frame("each")), (frame("option"), frame("option")));
}

/// Files of the movement of [`poses`], in a directory.
struct Files(TempDir);

impl Files {
    fn npz<'a>(&self, name: &str, arrays: impl IntoIterator<Item = (&'a str, Array2<f64>)>) {
        let mut file = NpzWriter::create(self.0.path().join(name)).unwrap();
        for (name, array) in arrays {
            file.add(name, &array).unwrap();
        }
        file.finish().unwrap();
    }

    fn npy<D: Dimension>(&self, name: &str, array: &ArrayRef<f64, D>) {
        write_npy(self.0.path().join(name), array).unwrap();
    }

    fn text(&self, name: &str, text: &str) {
        fs::write(self.0.path().join(name), text).unwrap();
    }
}

/// Python's text pickle of a dictionary of tables and numbers.
fn dictionary(entries: &[(&str, &Array2<f64>)]) -> String {
    let list = |numbers: &mut dyn Iterator<Item = &f64>| -> String {
        let numbers: Vec<String> = numbers.map(|x| format!("F{x:e}\na")).collect();
        format!("(l{}", numbers.concat())
    };
    let entries: Vec<String> = entries
        .iter()
        .map(|(name, table)| {
            let rows: Vec<String> =
                table.rows().into_iter().map(|row| format!("{}a", list(&mut row.iter()))).collect();
            format!("V{name}\n(l{}s", rows.concat())
        })
        .collect();
    format!("(d{}.", entries.concat())
}

/// Rotation matrices `[FRAMES, 24, 3, 3]` of [`poses`].
fn matrices() -> Array4<f64> {
    Array4::from_shape_fn((FRAMES, 24, 3, 3), |(frame, joint, row, column)| {
        let angles = [0, 1, 2].map(|axis| poses()[(frame, 3 * joint + axis)]);
        let turn = glam::DMat3::from_quat(glam::DQuat::from_scaled_axis(angles.into()));
        turn.col(column)[row]
    })
}

fn files() -> &'static Path {
    static FILES: OnceLock<Files> = OnceLock::new();
    let files = FILES.get_or_init(|| {
        let files = Files(tempfile::tempdir().unwrap());
        let zeros = |columns: usize| Array2::<f64>::zeros((FRAMES, columns));
        let part = |from: usize, to: usize| poses().slice(s![.., from..to]).to_owned();
        let beside = |parts: &[Array2<f64>]| {
            let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
            concatenate(Axis(1), &views).unwrap()
        };
        files.npy("plain.npy", &poses());
        files.npz("smplx.npz", [
            ("global_orient", part(0, 3)),
            ("body_pose", part(3, 66)),
            ("transl", zeros(3)),
            ("left_hand_pose", zeros(45)),
            ("expression", zeros(10)),
        ]);
        files.npz("romp.npz", [("smpl_thetas", poses()), ("smpl_betas", zeros(10))]);
        let by_joint: Array3<f64> = poses().into_shape_with_order((FRAMES, 24, 3)).unwrap();
        files.npy("by_joint.npy", &by_joint);
        files.npy("matrices.npy", &matrices());
        files.npy("with_trans.npy", &beside(&[poses(), zeros(3)]));
        files.npy("hmr.npy", &beside(&[zeros(3), poses(), zeros(10)]));
        files.npy("motion_x.npy", &beside(&[part(0, 66), zeros(256)]));
        let scale = Array2::from_elem((1, 1), 93.0);
        let dance = [("smpl_poses", &poses()), ("smpl_trans", &zeros(3)), ("smpl_scaling", &scale)];
        files.text("dance.pkl", &dictionary(&dance));
        let vibe = dictionary(&[("pose", &poses()), ("betas", &zeros(10))]);
        files.text("vibe.pkl", &format!("(dI1\n{}s.", vibe.trim_end_matches('.')));
        // An array of one object, as `numpy.save` of a dictionary.
        let mut object = NpyHeader::bytes("|O", &[]);
        object.extend(dictionary(&[("pred_rotmat", &matrices_by_row())]).bytes());
        fs::write(files.0.path().join("tram.npy"), object).unwrap();
        // EasyMocap: a file for each frame.
        fs::create_dir(files.0.path().join("easymocap")).unwrap();
        for (frame, pose) in poses().rows().into_iter().enumerate() {
            let person = serde_json::json!([{"id": 0, "Rh": [[0.0, 0.0, 0.0]], "Th": [[0.0, 0.0, 0.0]],
                "poses": [pose.to_vec()], "shapes": [vec![0.0; 10]]}]);
            files.text(&format!("easymocap/{frame:06}.json"), &person.to_string());
        }
        files
    });
    files.0.path()
}

/// Rows of 24 matrices, `[FRAMES, 216]`.
fn matrices_by_row() -> Array2<f64> {
    matrices().into_shape_with_order((FRAMES, 216)).unwrap()
}

#[test]
fn poses_of_other_tools_give_the_same_bodies() {
    let (data, place) = (trained(), tempfile::tempdir().unwrap());
    let sample = |name: &str| -> Vec<Mesh> {
        let out = place.path().join(name);
        let pose = files().join(name);
        let line = format!(
            "sample {} --outfit longlong --prior normal --temperature 0 --no-picture",
            data.at("run").display()
        );
        let mut words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        words.extend(["--pose".to_owned(), pose.display().to_string()]);
        words.extend(["--out".to_owned(), out.display().to_string()]);
        run(&words).succeeded();
        (0..FRAMES)
            .map(|frame| Mesh::load(out.join(format!("longlong_001_{frame:05}.obj"))).unwrap())
            .collect()
    };
    let expected = sample("plain.npy");
    assert_ne!(expected[0].vertices, expected[1].vertices);
    for name in [
        "smplx.npz",
        "romp.npz",
        "by_joint.npy",
        "matrices.npy",
        "with_trans.npy",
        "hmr.npy",
        "motion_x.npy",
        "dance.pkl",
        "vibe.pkl",
        "tram.npy",
        "easymocap",
    ] {
        for (found, expected) in sample(name).iter().zip(&expected) {
            let pairs = found.vertices.as_flattened().iter().zip(expected.vertices.as_flattened());
            let error = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(error < 1e-5, "{name}: {error}");
        }
    }
}

#[test]
fn what_is_no_motion_is_refused_before_work_starts() {
    let (data, place) = (trained(), tempfile::tempdir().unwrap());
    let at = |name: &str| place.path().join(name);
    write_npy(at("features.npy"), &Array2::<f64>::zeros((4, 263))).unwrap();
    write_npy(at("degrees.npy"), &poses().mapv(f64::to_degrees)).unwrap();
    write_npy(at("empty.npy"), &Array2::<f64>::zeros((0, 72))).unwrap();
    fs::write(at("walk.bvh"), "HIERARCHY\nROOT Hips\n").unwrap();
    fs::write(at("walk.fbx"), b"Kaydara FBX Binary  \0").unwrap();
    let mut archive = zip::ZipWriter::new(fs::File::create(at("hmr4d_results.pt")).unwrap());
    archive.start_file("hmr4d_results/data.pkl", zip::write::SimpleFileOptions::default()).unwrap();
    archive.finish().unwrap();
    let mut shape = NpzWriter::create(at("female_stageii.npz")).unwrap();
    shape.add("betas", &Array1::<f64>::zeros(16)).unwrap();
    shape.finish().unwrap();
    for (name, expected) in [
        ("features.npy", "features of HumanML3D"),
        ("degrees.npy", "expected radians"),
        ("empty.npy", "holds no pose"),
        ("walk.bvh", "BVH"),
        ("walk.fbx", "FBX"),
        ("hmr4d_results.pt", "PyTorch"),
        ("female_stageii.npz", "shape of a subject without poses"),
    ] {
        let motion = at(name).display().to_string();
        let out = at("out").display().to_string();
        let run_path = data.at("run").display().to_string();
        run(["animate", &run_path, "--outfit", "longlong", "--motion", &motion, "--out", &out])
            .failed_saying(&[name, expected]);
        run(["sample", &run_path, "--outfit", "longlong", "--pose", &motion, "--out", &out])
            .failed_saying(&[name, expected]);
        assert!(!at("out").exists());
    }
}
