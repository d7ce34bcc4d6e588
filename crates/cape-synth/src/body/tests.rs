use std::{collections::HashMap, sync::LazyLock};

use glam::DVec3;
use ndarray::{Array2, Axis};

use super::{FACES, VERTICES, figure, remesh::shape_quality, synthetic_body};
use cape_core::{SmplModel, joints::JOINTS};

static BODY: LazyLock<SmplModel> = LazyLock::new(synthetic_body);

fn points(array: &Array2<f64>) -> Vec<DVec3> {
    array.rows().into_iter().map(|r| DVec3::new(r[0], r[1], r[2])).collect()
}

fn with_shape(direction: usize, coefficient: f64) -> Array2<f64> {
    &BODY.v_template + &(&BODY.shapedirs.index_axis(Axis(2), direction) * coefficient)
}

fn joints(vertices: &Array2<f64>) -> Vec<DVec3> {
    points(&BODY.joint_regressor.dot(vertices))
}

fn volume(vertices: &[DVec3], faces: &[[u32; 3]]) -> f64 {
    faces
        .iter()
        .map(|f| {
            let [a, b, c] = f.map(|v| vertices[v as usize]);
            a.dot(b.cross(c)) / 6.0
        })
        .sum()
}

/// The body posed by `rotations` of joints, with or without pose directions.
fn posed(rotations: &[(usize, DVec3)], corrected: bool) -> Vec<DVec3> {
    static PLAIN: LazyLock<SmplModel> = LazyLock::new(|| {
        let mut body = BODY.clone();
        body.posedirs.fill(0.0);
        body
    });
    let mut pose = [0.0; 3 * JOINTS];
    for &(joint, axis) in rotations {
        pose[3 * joint..3 * joint + 3].copy_from_slice(&axis.to_array());
    }
    let body = if corrected { &BODY } else { &PLAIN };
    points(&body.pose(&[], &pose, [0.0; 3], None).unwrap().vertices)
}

#[test]
fn closed_manifold_of_genus_zero_with_smpl_counts() {
    assert_eq!((BODY.vertices(), BODY.faces.len()), (VERTICES, FACES));
    assert_eq!((VERTICES, FACES), (6890, 13776));
    BODY.validate().unwrap();
    let mut directed: HashMap<(u32, u32), usize> = HashMap::new();
    for &[a, b, c] in &BODY.faces {
        for edge in [(a, b), (b, c), (c, a)] {
            *directed.entry(edge).or_default() += 1;
        }
    }
    // Each edge once per direction: two consistently oriented faces per edge.
    assert!(directed.iter().all(|(&(a, b), &n)| n == 1 && directed.contains_key(&(b, a))));
    let edges = directed.len() / 2;
    assert_eq!(VERTICES as i64 - edges as i64 + FACES as i64, 2);
    let mut valence = vec![0; VERTICES];
    for &(a, _) in directed.keys() {
        valence[a as usize] += 1;
    }
    assert!(valence.iter().all(|n| (4..=8).contains(n)));
    assert!(valence.iter().filter(|&&n| n == 6).count() * 10 > VERTICES * 7);
    // The faces of a vertex form one fan.
    let next: HashMap<(u32, u32), u32> =
        BODY.faces.iter().flat_map(|&[a, b, c]| [((a, b), c), ((b, c), a), ((c, a), b)]).collect();
    let mut fan = vec![0; VERTICES];
    let mut first: HashMap<u32, u32> = HashMap::new();
    first.extend(next.keys().copied());
    for (&v, &start) in &first {
        let mut at = start;
        loop {
            at = next[&(v, at)];
            fan[v as usize] += 1;
            if at == start {
                break;
            }
        }
    }
    assert_eq!(fan, valence);
}

#[test]
fn triangles_are_well_shaped_and_face_outwards() {
    let vertices = points(&BODY.v_template);
    let volume = volume(&vertices, &BODY.faces);
    assert!((0.05..0.08).contains(&volume), "{volume} m³");
    for f in &BODY.faces {
        let [a, b, c] = f.map(|v| vertices[v as usize]);
        assert!(shape_quality(a, b, c) > 0.6);
        let angle = [(a, b, c), (b, c, a), (c, a, b)]
            .map(|(p, q, r)| (q - p).angle_between(r - p).to_degrees());
        assert!(angle.iter().all(|&d| d > 28.0), "{angle:?} at {a}");
        let edges = [a.distance(b), b.distance(c), c.distance(a)];
        assert!(edges.iter().all(|l| (0.004..0.034).contains(l)), "{edges:?}");
    }
}

#[test]
fn vertices_lie_on_the_figure() {
    let sdf = figure::body_sdf();
    for p in points(&BODY.v_template) {
        let off = sdf.distance(p).abs();
        assert!(off < 2e-4, "{off} m at {p}");
    }
}

#[test]
fn limbs_stay_apart_at_rest() {
    let sdf = figure::body_sdf();
    // Between the legs, under the arms, between the fingers.
    let free = [
        [0.0, -0.45, 0.0],
        [0.0, -0.8, -0.01],
        [0.0, -1.13, 0.05],
        [0.24, 0.10, -0.03],
        [0.82, 0.215, -0.019],
        [0.82, 0.215, -0.049],
        [0.81, 0.213, -0.076],
    ];
    for p in free {
        assert!(sdf.distance(DVec3::from_array(p)) > 1e-3, "{p:?}");
    }
}

#[test]
fn human_size_and_exact_mirror_symmetry() {
    let vertices = points(&BODY.v_template);
    let low = vertices.iter().copied().reduce(DVec3::min).unwrap();
    let high = vertices.iter().copied().reduce(DVec3::max).unwrap();
    assert!((1.68..1.73).contains(&(high.y - low.y)));
    assert!((1.60..1.80).contains(&(high.x - low.x)));
    let key = |p: DVec3| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits()];
    let index: HashMap<_, usize> = vertices.iter().enumerate().map(|(v, &p)| (key(p), v)).collect();
    assert_eq!(index.len(), VERTICES);
    for (v, &p) in vertices.iter().enumerate() {
        let m = if p.x == 0.0 { v } else { index[&key(DVec3::new(-p.x, p.y, p.z))] };
        for j in 0..JOINTS {
            assert_eq!(BODY.weights[[v, j]], BODY.weights[[m, figure::MIRRORED[j]]]);
        }
        for d in 0..BODY.betas() {
            assert_eq!(BODY.shapedirs[[v, 0, d]], -BODY.shapedirs[[m, 0, d]]);
            assert_eq!(BODY.shapedirs[[v, 1, d]], BODY.shapedirs[[m, 1, d]]);
        }
    }
}

#[test]
fn weights_are_sparse_smooth_and_sum_to_one() {
    for row in BODY.weights.rows() {
        assert!((row.sum() - 1.0).abs() < 1e-12);
        assert!(row.iter().all(|&w| w >= 0.0));
        assert!(row.iter().filter(|&&w| w > 0.0).count() <= 4);
    }
    let vertices = points(&BODY.v_template);
    for &[a, b, c] in &BODY.faces {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            let (p, q) = (p as usize, q as usize);
            let change: f64 =
                (0..JOINTS).map(|j| (BODY.weights[[p, j]] - BODY.weights[[q, j]]).abs()).sum();
            assert!(change / 2.0 < 45.0 * vertices[p].distance(vertices[q]), "{}", vertices[p]);
        }
    }
    for (v, p) in vertices.iter().enumerate() {
        let of = |joints: &[usize]| joints.iter().map(|&j| BODY.weights[[v, j]]).sum::<f64>();
        let (left_leg, left_arm) = (of(&[1, 4, 7, 10]), of(&[16, 18, 20, 22]));
        assert!(p.x > -0.09 || left_leg + left_arm == 0.0);
        assert!(p.y > -0.47 || p.x > 0.0 || left_leg == 0.0);
        assert!(p.y < -0.1 || left_leg == 0.0);
        assert!(p.x > 0.06 || left_arm < 1e-9);
        assert!(p.y > 0.05 || left_arm < 1e-9);
        assert!(p.x < 0.29 || left_arm > 0.999);
        assert!(p.y > -0.50 || of(&[1, 2, 4, 5, 7, 8, 10, 11]) > 0.99);
    }
}

#[test]
fn the_regressor_gives_the_joints() {
    for (row, (found, wanted)) in BODY
        .joint_regressor
        .rows()
        .into_iter()
        .zip(joints(&BODY.v_template).iter().zip(figure::joints()))
    {
        assert!((row.sum() - 1.0).abs() < 1e-9);
        assert!(row.iter().all(|&w| (0.0..0.2).contains(&w)));
        assert!(row.iter().filter(|&&w| w != 0.0).count() < 200);
        assert!(found.distance(wanted) < 1e-9);
    }
}

#[test]
fn every_call_makes_the_same_body() {
    assert_eq!(synthetic_body(), *BODY);
}

#[test]
fn shape_directions_are_orthogonal_and_change_the_named_measure() {
    let directions = BODY.shapedirs.view().into_shape_with_order((VERTICES * 3, 10)).unwrap();
    let gram = directions.t().dot(&directions);
    for i in 0..10 {
        for j in 0..i {
            assert!(gram[[i, j]].abs() < 1e-9 * (gram[[i, i]] * gram[[j, j]]).sqrt().max(1e-3));
        }
    }
    let stature = |v: &Array2<f64>| {
        let y = v.column(1);
        y.fold(f64::NEG_INFINITY, |a, &b| a.max(b)) - y.fold(f64::INFINITY, |a, &b| a.min(b))
    };
    let rest = &BODY.v_template;
    let litres = |v: &Array2<f64>| volume(&points(v), &BODY.faces) * 1000.0;
    let grown = stature(&with_shape(0, 1.0)) - stature(rest);
    assert!((0.05..0.08).contains(&grown), "{grown}");
    let heavier = litres(&with_shape(1, 1.0)) - litres(rest);
    assert!((6.0..14.0).contains(&heavier), "{heavier}");
    assert!((stature(&with_shape(1, 1.0)) - stature(rest)).abs() < 0.02);
    let change = |direction: usize, a: usize, b: usize| {
        let after = joints(&with_shape(direction, 1.0));
        let before = joints(rest);
        after[a].distance(after[b]) - before[a].distance(before[b])
    };
    let expected = [
        (2, 16, 20, 0.008), // longer arms
        (2, 1, 7, 0.004),   // longer legs
        (3, 1, 7, 0.004),   // longer legs, shorter trunk
        (3, 0, 12, -0.004),
        (4, 16, 17, 0.010), // wider shoulders
        (5, 1, 2, 0.002),   // wider hips
    ];
    for (direction, a, b, least) in expected {
        let change = change(direction, a, b);
        assert!(change / least > 1.0, "direction {direction}, joints {a} and {b}: {change}");
    }
    for direction in 0..10 {
        for coefficient in [-2.0, 2.0] {
            let body = with_shape(direction, coefficient);
            assert!((1.5..1.9).contains(&stature(&body)));
            assert!((38.0..90.0).contains(&litres(&body)));
        }
    }
}

#[test]
fn pose_directions_keep_the_volume_of_bent_joints() {
    let rest = volume(&points(&BODY.v_template), &BODY.faces);
    let cases: [(&str, Vec<(usize, DVec3)>); 4] = [
        ("elbows", vec![(18, DVec3::Y * -1.6), (19, DVec3::Y * 1.6)]),
        ("knees", vec![(4, DVec3::X * 1.6), (5, DVec3::X * 1.6)]),
        ("forearm twist", vec![(20, DVec3::X * 1.2), (21, DVec3::X * 1.2)]),
        ("waist twist", vec![(3, DVec3::Y * 0.6), (6, DVec3::Y * 0.6)]),
    ];
    for (name, pose) in cases {
        let lost = |corrected| (volume(&posed(&pose, corrected), &BODY.faces) - rest).abs();
        let (with, without) = (lost(true), lost(false));
        assert!(with < 0.6 * without, "{name}: {with} with, {without} without");
    }
    assert_eq!(posed(&[], true), posed(&[], false));
}
