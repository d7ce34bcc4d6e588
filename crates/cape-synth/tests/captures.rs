//! Statistics of the synthetic wardrobe compared with those of real captures, and with a linear model.

use std::{collections::HashSet, sync::OnceLock};

use cape_core::{
    Outfit, SmplModel,
    npy::{Npz, read_f64, read_i64},
    pickle::Pickle,
    smpl::SubjectBodies,
};
use cape_synth::{
    CaptureGenerator, GarmentLengths, Motion, MotionStyle, SubjectGroup, SynthSequence, SynthSpec,
    Wardrobe, synthetic_body,
};
use ndarray::{Array1, Array2, Axis, s};
use rayon::prelude::*;

/// Medians over the 3627 clothing vertices of the real male training displacements' |mean| and
/// standard deviation (population), millimetres, along x, y, z.
const REAL_MEAN: [f64; 3] = [3.252, 5.369, 3.715];
const REAL_DEVIATION: [f64; 3] = [7.828, 8.154, 7.844];

fn body() -> &'static SmplModel {
    static BODY: OnceLock<SmplModel> = OnceLock::new();
    BODY.get_or_init(synthetic_body)
}

/// Mean distance between two sets of vertices, millimetres.
fn distance(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    1000.0 * mean_length(&(a - b))
}

/// Displacements on clothing vertices, millimetres, one row per frame, of training or test motions.
fn displacements(synth: &CaptureGenerator<'_>, clothing: &[usize], test: bool) -> Array2<f64> {
    let spec = synth.spec();
    let takes: Vec<_> =
        spec.sequences().into_iter().filter(|take| take.motion.is_test() == test).collect();
    let rows: Vec<Vec<f64>> = takes
        .par_iter()
        .flat_map_iter(|&take| {
            let session = synth.prepare(take).unwrap();
            (0..spec.frames_per_sequence).map(move |frame| {
                let displacement = synth.displacement(&session, frame).unwrap();
                let rows = clothing.iter().flat_map(|&v| displacement.row(v).to_vec());
                rows.map(|metres| 1000.0 * metres).collect()
            })
        })
        .collect();
    let shape = (rows.len(), 3 * clothing.len());
    Array2::from_shape_vec(shape, rows.into_iter().flatten().collect()).unwrap()
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Orthonormal principal directions `[components, features]` of centred rows, by subspace iteration
/// on the Gram matrix of the rows.
fn principal_directions(centred: &Array2<f64>, components: usize) -> Array2<f64> {
    let gram = centred.dot(&centred.t());
    let n = gram.nrows();
    let mut basis =
        Array2::from_shape_fn((n, components + 8), |(i, j)| ((i * 37 + j * 101 + 11) as f64).sin());
    for _ in 0..60 {
        basis = gram.dot(&basis);
        orthonormalise(basis.view_mut().reversed_axes());
    }
    // Rotate to the eigenvectors within the subspace by Jacobi's method.
    let mut small = basis.t().dot(&gram).dot(&basis);
    let mut turn = Array2::<f64>::eye(small.nrows());
    for _ in 0..30 {
        for p in 0..small.nrows() {
            for q in p + 1..small.nrows() {
                let angle = 0.5 * (2.0 * small[[p, q]]).atan2(small[[q, q]] - small[[p, p]]);
                let (sin, cos) = angle.sin_cos();
                let mut rotation = Array2::<f64>::eye(small.nrows());
                rotation[[p, p]] = cos;
                rotation[[q, q]] = cos;
                rotation[[p, q]] = sin;
                rotation[[q, p]] = -sin;
                small = rotation.t().dot(&small).dot(&rotation);
                turn = turn.dot(&rotation);
            }
        }
    }
    let mut order: Vec<usize> = (0..small.nrows()).collect();
    order.sort_by(|&a, &b| small[[b, b]].total_cmp(&small[[a, a]]));
    let scores = basis.dot(&turn).select(Axis(1), &order[..components]);
    let mut directions = scores.t().dot(centred);
    orthonormalise(directions.view_mut());
    directions
}

/// Gram–Schmidt over rows.
fn orthonormalise(mut rows: ndarray::ArrayViewMut2<'_, f64>) {
    for i in 0..rows.nrows() {
        let (done, mut rest) = rows.view_mut().split_at(Axis(0), i);
        let mut row = rest.row_mut(0);
        for other in done.rows() {
            let along = other.dot(&row);
            row.scaled_add(-along, &other);
        }
        let length = row.dot(&row).sqrt();
        row /= length;
    }
}

/// Mean Euclidean length of the rows' 3-vectors.
fn mean_length(rows: &Array2<f64>) -> f64 {
    let vectors = rows.as_slice().unwrap().chunks_exact(3);
    let count = vectors.len();
    vectors.map(|v| v[0].hypot(v[1]).hypot(v[2])).sum::<f64>() / count as f64
}

#[test]
fn statistics_are_near_the_real_ones_and_no_linear_model_of_18_explains_them() {
    let spec =
        SynthSpec { subjects: 4, frames_per_sequence: 4, frame_rate: 2.1, ..SynthSpec::default() };
    let synth = CaptureGenerator::new(body(), spec).unwrap();
    let clothing = synth.clothing_vertices();
    assert!((3100..=4200).contains(&clothing.len()), "{}", clothing.len());

    let mut train = displacements(&synth, &clothing, false);
    let mean = train.mean_axis(Axis(0)).unwrap();
    let deviation = train.std_axis(Axis(0), 0.0);
    let mut ratios = Vec::new();
    for axis in 0..3 {
        let along = |values: &Array1<f64>| {
            median(values.slice(s![axis..;3]).iter().map(|value| value.abs()))
        };
        let (mean, deviation) = (along(&mean), along(&deviation));
        println!("axis {axis}: |mean| {mean:.2} mm, deviation {deviation:.2} mm");
        ratios.extend([mean / REAL_MEAN[axis], deviation / REAL_DEVIATION[axis]]);
    }
    println!("ratios {ratios:.2?}");

    train -= &mean;
    let test = displacements(&synth, &clothing, true) - &mean;
    let directions = principal_directions(&train, 18);
    let residual = |rows: &Array2<f64>| {
        let explained = rows.dot(&directions.t()).dot(&directions);
        mean_length(&(rows - &explained))
    };
    let (own, held_out) = (residual(&train), residual(&test));
    println!(
        "PCA(18): {own:.2} mm on training, {held_out:.2} mm on held-out sequences, of {:.2}",
        mean_length(&test)
    );
    assert!((2.0..=7.0).contains(&held_out), "{held_out} mm");
    assert!(own < held_out);
    assert!(ratios.iter().all(|ratio| (1.0 / 1.5..=1.5).contains(ratio)), "{ratios:?}");
}

#[test]
fn head_hands_and_feet_are_bare() {
    let wardrobe = Wardrobe::new(body(), 5).unwrap();
    let clothing: HashSet<usize> = wardrobe.clothing_vertices().into_iter().collect();
    for (index, joint) in [(15, "head"), (20, "wrist"), (22, "hand"), (8, "ankle"), (11, "foot")] {
        let bound = body().weights.column(index);
        let dressed = clothing.iter().filter(|&&vertex| bound[vertex] > 0.9).count();
        assert_eq!(dressed, 0, "{joint}");
    }
    for outfit in Outfit::PAPER {
        let fitting = wardrobe.fit(wardrobe.outfit_style(0, outfit, 3).unwrap());
        let pose = Motion::PoseModel.pose(&MotionStyle::default(), 2.0);
        let displacement = wardrobe.displacement(&fitting, &pose, 2.0, None).unwrap();
        let coverage = fitting.coverage();
        for (vertex, moved) in displacement.rows().into_iter().enumerate() {
            let covered = coverage[vertex] != [false; 2];
            assert_eq!(moved.iter().any(|&x| x != 0.0), covered, "vertex {vertex}");
            assert!(!covered || clothing.contains(&vertex));
            assert!(moved.iter().all(|x| x.abs() < 0.12), "vertex {vertex}: {moved}");
        }
    }
}

#[test]
fn sleeves_and_legs_are_as_long_as_the_outfit_says() {
    let wardrobe = Wardrobe::new(body(), 2).unwrap();
    let part = |joints: [usize; 2], garment: usize, outfit: Outfit, sequence: usize| {
        let coverage = wardrobe.fit(wardrobe.outfit_style(1, outfit, sequence).unwrap()).coverage();
        let bound = joints.map(|joint| body().weights.column(joint));
        let (mut all, mut covered) = (0, 0);
        for vertex in wardrobe.clothing_vertices() {
            if bound[0][vertex] + bound[1][vertex] > 0.95 {
                all += 1;
                covered += usize::from(coverage[vertex][garment]);
            }
        }
        covered as f64 / f64::from(all)
    };
    for outfit in Outfit::PAPER {
        let lengths = GarmentLengths::from_outfit(outfit).unwrap();
        for sequence in 0..10 {
            let forearms = part([18, 19], 0, outfit, sequence);
            assert_eq!(forearms > 0.6, lengths.long_sleeves, "{outfit}: {forearms}");
            assert!(lengths.long_sleeves || forearms < 0.1, "{outfit}: {forearms}");
            let shins = part([4, 5], 1, outfit, sequence);
            assert_eq!(shins > 0.6, lengths.long_legs, "{outfit}: {shins}");
            assert!(lengths.long_legs || shins < 0.25, "{outfit}: {shins}");
        }
    }
}

#[test]
fn hems_are_steps_within_one_edge() {
    let wardrobe = Wardrobe::new(body(), 9).unwrap();
    let fitting = wardrobe.fit(wardrobe.outfit_style(0, Outfit::SHORT_SHORT, 0).unwrap());
    let displacement = wardrobe.displacement(&fitting, &[0.0; 72], 0.0, None).unwrap();
    let dressed: Vec<bool> = fitting.coverage().iter().map(|c| *c != [false; 2]).collect();
    let length = |v: usize| displacement.row(v).dot(&displacement.row(v)).sqrt();
    let mut steps = Vec::new();
    for face in &body().faces {
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (from, to) = (face[from] as usize, face[to] as usize);
            if dressed[from] && !dressed[to] {
                steps.push(1000.0 * (length(from) - length(to)));
            }
        }
    }
    assert!(steps.len() > 100, "{} edges cross a hem", steps.len());
    let step = median(steps.into_iter());
    assert!(step > 3.0, "{step} mm");
}

#[test]
fn garments_last_a_sequence_and_are_not_a_function_of_the_pose() {
    let wardrobe = Wardrobe::new(body(), 4).unwrap();
    let wear = |sequence: usize, motion: Motion, noise: Option<u64>| {
        let fitting = wardrobe.fit(wardrobe.outfit_style(0, Outfit::LONG_LONG, sequence).unwrap());
        let pose = motion.pose(&MotionStyle::default(), 1.0);
        wardrobe.displacement(&fitting, &pose, 0.0, noise).unwrap()
    };
    let first = wear(0, Motion::Simple, None);
    assert_eq!(first, wear(0, Motion::Simple, None));
    let other_state = distance(&first, &wear(1, Motion::Simple, None));
    let other_pose = distance(&first, &wear(0, Motion::Squats, None));
    let scan = |number| wear(0, Motion::Simple, Some(number));
    let (noise, misfit) = (distance(&scan(1), &scan(2)), distance(&first, &scan(1)));
    assert!(other_state > 3.0 && other_pose > 1.5, "{other_state} {other_pose} mm");
    // The mean length of the difference of two normal 3-vectors with 0.15 mm per coordinate.
    let expected = 0.15 * 2f64.sqrt() * (8.0 / std::f64::consts::PI).sqrt();
    assert!((noise - expected).abs() < 0.02, "{noise} mm");
    assert!((0.5..2.5).contains(&misfit), "{misfit} mm");
    assert_ne!(wear(0, Motion::Simple, Some(1)), wear(0, Motion::Simple, Some(2)));
}

#[test]
fn files_follow_the_release_whatever_the_number_of_threads() {
    let spec = SynthSpec {
        subjects: 1,
        frames_per_sequence: 3,
        outfits: vec![Outfit::LONG_SHORT],
        motions: vec![Motion::Squats, Motion::Soccer],
        ..SynthSpec::default()
    };
    let synth = CaptureGenerator::new(body(), spec).unwrap();
    let write = |threads: usize| {
        let directory = tempfile::tempdir().unwrap();
        let mut seen = Vec::new();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut progress = |done, total| seen.push((done, total));
        let frames: Vec<_> = pool.install(|| {
            synth.write(directory.path(), &mut progress).unwrap();
            synth.spec().sequences().iter().map(|&take| synth.frames(take).unwrap()).collect()
        });
        assert_eq!(seen, [(0, 6), (3, 6), (6, 6)]);
        (directory, frames)
    };
    let ((directory, frames), (_, again)) = (write(1), write(3));
    assert_eq!(frames, again);

    let root = directory.path();
    assert_eq!(SmplModel::load(root.join("body.npz")).unwrap().faces, body().faces);
    let clothing = read_i64(root.join("clothing_verts_idx.npy")).unwrap();
    assert_eq!(clothing.len(), synth.clothing_vertices().len());
    let minimal = read_f64(root.join("minimal_body_shape/s0001/s0001_minimal.npy")).unwrap();
    let minimal: Array2<f64> = minimal.into_dimensionality().unwrap();
    let name = "longshort_squats";
    let path = root.join(format!("sequences/s0001/{name}/{name}.000002.npz"));
    let mut frame = Npz::open(path).unwrap();
    assert_eq!(frame.names(), ["v_cano", "v_posed", "pose", "transl"]);
    let get = |frame: &mut Npz, key| -> Array2<f64> {
        frame.f64(key).unwrap().into_dimensionality().unwrap()
    };
    let (cano, posed) = (get(&mut frame, "v_cano"), get(&mut frame, "v_posed"));
    let pose = frame.f64("pose").unwrap();
    let transl = frame.f64("transl").unwrap();
    let take = SynthSequence { subject: 0, outfit: Outfit::LONG_SHORT, motion: Motion::Squats };
    let session = synth.prepare(take).unwrap();
    let displacement = synth.displacement(&session, 1).unwrap();
    assert!(distance(&(&cano - &minimal), &displacement) < 1e-4);
    let unposed = body()
        .unpose_shape(&posed, &minimal, pose.as_slice().unwrap(), [transl[0], transl[1], transl[2]])
        .unwrap();
    assert!(distance(&unposed, &cano) < 1e-3);
    let lowest = posed.column(1).iter().copied().fold(f64::INFINITY, f64::min);
    assert!(lowest.abs() < 1e-6, "{lowest}");
}

#[test]
fn subjects_have_the_bodies_of_their_genders_whatever_the_number_of_threads() {
    let mut female = body().clone();
    female.v_template.mapv_inplace(|x| 0.9 * x);
    let bodies = SubjectBodies::Genders { male: body(), female: &female };
    let spec = SynthSpec {
        subjects: 3,
        frames_per_sequence: 2,
        outfits: vec![Outfit::LONG_LONG],
        motions: vec![Motion::Squats],
        ..SynthSpec::default()
    };
    let synth = CaptureGenerator::new(bodies, spec.clone()).unwrap();
    let names: Vec<_> = synth.groups().iter().map(SubjectGroup::subject_names).collect();
    assert_eq!(names, [vec!["s0001", "s0003"], vec!["s0002"]]);
    let wardrobe = Wardrobe::new(body(), spec.seed).unwrap();
    let write = |threads: usize| {
        let directory = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| synth.write(directory.path(), &mut |_, _| {}).unwrap());
        directory
    };
    let (one, three) = (write(1), write(3));
    for (subject, own) in [body(), &female, body()].into_iter().enumerate() {
        let name = format!("s{:04}", subject + 1);
        let place = format!("minimal_body_shape/{name}/{name}_minimal.npy");
        let minimal = read_f64(one.path().join(&place)).unwrap();
        let expected = own.rest_shape(&wardrobe.betas(subject)).unwrap();
        assert_eq!(minimal, expected.into_dyn());
        let frame = format!("sequences/{name}/longlong_squats/longlong_squats.000002.npz");
        for file in [place, frame] {
            let read = |root: &tempfile::TempDir| std::fs::read(root.path().join(&file)).unwrap();
            assert!(read(&one) == read(&three), "{file}");
        }
    }
    let genders = Pickle::open(one.path().join("misc/subj_genders.pkl")).unwrap();
    assert_eq!(genders.root().require("s0002").unwrap().text().unwrap(), "female");
    assert_eq!(SmplModel::load(one.path().join("body_female.npz")).unwrap(), female);
    assert!(!one.path().join("body.npz").exists());
    // A subject alone has no companions' files.
    let alone = CaptureGenerator::new(bodies, SynthSpec { subjects: 1, ..spec }).unwrap();
    assert_eq!(alone.groups().len(), 1);
}

#[test]
fn unusable_requests_are_errors() {
    let message = |spec: SynthSpec| CaptureGenerator::new(body(), spec).unwrap_err().to_string();
    let spec = SynthSpec::default;
    assert!(message(SynthSpec { subjects: 0, ..spec() }).contains("subjects"));
    assert!(message(SynthSpec { frames_per_sequence: 0, ..spec() }).contains("frames"));
    assert!(message(SynthSpec { frame_rate: f64::NAN, ..spec() }).contains("rate"));
    let wardrobe = Wardrobe::new(body(), 1).unwrap();
    let fitting = wardrobe.fit(wardrobe.outfit_style(0, Outfit::LONG_LONG, 0).unwrap());
    let failed = wardrobe.displacement(&fitting, &[0.0; 71], 0.0, None).unwrap_err();
    assert!(failed.to_string().contains("71"));
    let mut short = body().clone();
    short.weights = short.weights.slice(s![.., ..20]).to_owned();
    assert!(Wardrobe::new(&short, 1).unwrap_err().to_string().contains("20 joints"));
}
