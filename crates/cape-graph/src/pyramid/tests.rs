use proptest::prelude::*;
use sprs::{CsMat, TriMat};

use super::*;
use crate::parts::PyramidParts;
use crate::vector::{V3, cross, dot, sub};

/// A torus of `nu` × `nv` vertices, or a grid of as many if it is open, every vertex moved by noise.
fn mesh(closed: bool, nu: usize, nv: usize, noise: f64, seed: u64) -> Surface {
    let mut state = seed;
    let mut random = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut vertices = Vec::new();
    for (i, j) in (0..nu).flat_map(|i| (0..nv).map(move |j| (i, j))) {
        let position = if closed {
            let (u, v) =
                [(i, nu), (j, nv)].map(|(k, n)| std::f64::consts::TAU * k as f64 / n as f64).into();
            let (u, v): (f64, f64) = (u, v);
            [(1.0 + 0.4 * v.cos()) * u.cos(), (1.0 + 0.4 * v.cos()) * u.sin(), 0.4 * v.sin()]
        } else {
            [i as f64 / nu as f64, j as f64 / nu as f64, 1.0]
        };
        vertices.push(position.map(|x| x + noise * random()));
    }
    let at = |i: usize, j: usize| ((i % nu) * nv + j % nv) as u32;
    let (rows, columns) = if closed { (nu, nv) } else { (nu - 1, nv - 1) };
    let faces = (0..rows)
        .flat_map(|i| (0..columns).map(move |j| (i, j)))
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    Surface { vertices, faces }
}

fn tetrahedron() -> Surface {
    Surface {
        vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    }
}

fn add(a: V3, b: V3, factor: f64) -> V3 {
    std::array::from_fn(|i| a[i] + factor * b[i])
}

fn distance(a: V3, b: V3) -> f64 {
    dot(sub(a, b), sub(a, b)).sqrt()
}

/// Distance to every triangle in turn: to its plane where the foot is inside, and to its edges.
fn brute_force_distance(surface: &Surface, p: V3) -> f64 {
    let mut best = f64::INFINITY;
    for corners in surface.faces.iter().map(|face| face.map(|v| surface.vertices[v as usize])) {
        let [a, b, c] = corners;
        for (a, b) in [(a, b), (b, c), (c, a)] {
            let edge = sub(b, a);
            let t = (dot(sub(p, a), edge) / dot(edge, edge)).clamp(0.0, 1.0);
            best = best.min(distance(p, add(a, edge, t)));
        }
        let normal = cross(sub(b, a), sub(c, a));
        let foot = add(p, normal, -dot(sub(p, a), normal) / dot(normal, normal));
        let inside =
            |a: V3, b: V3| dot(cross(sub(b, a), sub(foot, a)), normal) / dot(normal, normal) >= 0.0;
        if inside(a, b) && inside(b, c) && inside(c, a) {
            best = best.min(distance(p, foot));
        }
    }
    best
}

/// `matrix · vertices`.
fn apply(matrix: &CsMat<f64>, vertices: &[V3]) -> Vec<V3> {
    matrix
        .outer_iterator()
        .map(|row| row.iter().fold([0.0; 3], |sum, (j, &w)| add(sum, vertices[j], w)))
        .collect()
}

fn parts(pyramid: &MeshPyramid) -> PyramidParts {
    PyramidParts {
        surface: pyramid.levels[0].surface.clone(),
        // Other programs count every edge twice.
        adjacency: pyramid.levels.iter().map(|level| level.adjacency.map(|x| 2.0 * x)).collect(),
        down: pyramid.transitions.iter().map(Transition::down_matrix).collect(),
        up: pyramid.transitions.iter().map(|transition| transition.up.clone()).collect(),
        faces: pyramid.levels[1..].iter().map(|level| level.surface.faces.clone()).collect(),
        weighting: pyramid.weighting,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn levels_are_selections_and_interpolations(
        closed: bool,
        nu in 4usize..16,
        nv in 4usize..16,
        noise in 0.001f64..0.1,
        seed: u64,
        factor in 1.0f64..3.0,
    ) {
        let surface = mesh(closed, nu, nv, noise, seed);
        prop_assume!((surface.vertices.len() as f64 / factor / 1.5).ceil() >= 6.0);
        let factors = [factor, 1.0, 1.5];
        let pyramid = MeshPyramid::build(&surface, &factors, Weighting::Barycentric).unwrap();
        let release = MeshPyramid::build(&surface, &factors, Weighting::Release).unwrap();
        prop_assert_eq!(&pyramid.levels, &release.levels);
        prop_assert!(pyramid.transitions[1].is_identity());

        for (i, transition) in pyramid.transitions.iter().enumerate() {
            let [fine, coarse] = [i, i + 1].map(|level| &pyramid.levels[level].surface);
            let target = (fine.vertices.len() as f64 * (1.0 / factors[i])).ceil() as usize;
            prop_assert!(coarse.vertices.len() <= target);
            prop_assert!(transition.down.is_sorted_by(|a, b| a < b));
            prop_assert_eq!(&apply(&transition.down_matrix(), &fine.vertices), &coarse.vertices);
            if closed {
                prop_assert_eq!(coarse.edge_counts().boundary, 0);
            }

            let points = apply(&transition.up, &coarse.vertices);
            let rows = transition.up.outer_iterator().zip(release.transitions[i].up.outer_iterator());
            for ((row, release), (point, vertex)) in rows.zip(points.iter().zip(&fine.vertices)) {
                prop_assert!(row.data().iter().all(|&w| w >= 0.0));
                prop_assert!((row.data().iter().sum::<f64>() - 1.0).abs() < 1e-12);
                let on_face = coarse.faces.iter().any(|face| {
                    row.indices().iter().all(|&j| face.contains(&(j as u32)))
                });
                prop_assert!(on_face);
                let nearest = brute_force_distance(coarse, *vertex);
                prop_assert!((distance(*point, *vertex) - nearest).abs() < 1e-9);

                prop_assert_eq!(row.indices(), release.indices());
                if let &[a, b] = row.indices() {
                    let [a, b] = [a, b].map(|j| coarse.vertices[j]);
                    let [wa, wb] = [release.data()[0], release.data()[1]];
                    let residual = sub(add(a.map(|x| wa * x), b, wb), *vertex);
                    prop_assert!(dot(residual, a).abs() < 1e-9 && dot(residual, b).abs() < 1e-9);
                } else {
                    prop_assert_eq!(row.data(), release.data());
                }
            }
        }
        prop_assert_eq!(MeshPyramid::from_parts(parts(&pyramid)).unwrap(), pyramid);
    }

    #[test]
    fn edges_and_adjacency_are_those_of_the_faces(
        closed: bool, nu in 3usize..12, nv in 3usize..12, again in 0usize..5, seed: u64,
    ) {
        let mut surface = mesh(closed, nu, nv, 0.1, seed);
        // Faces that share an edge with more than one other, and one with a vertex that is not there.
        surface.faces.extend_from_within(..again);
        let mut expected: Vec<_> = surface
            .faces
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]))
            .collect();
        expected.sort_unstable();
        expected.dedup();
        prop_assert_eq!(surface.edges(), expected.clone());
        let n = surface.vertices.len();
        let mut triplets = TriMat::new((n, n));
        for [a, b] in expected.iter().map(|edge| edge.map(|vertex| vertex as usize)) {
            triplets.add_triplet(a, b, 1.0);
            triplets.add_triplet(b, a, 1.0);
        }
        prop_assert_eq!(surface.adjacency(), triplets.to_csr::<usize>());
        surface.faces.push([0, 1, n as u32]);
        expected.extend([[0, n as u32], [1, n as u32]]);
        expected.push([0, 1]);
        expected.sort_unstable();
        expected.dedup();
        prop_assert_eq!(surface.edges(), expected);
    }

    #[test]
    fn laplacians_are_symmetric_with_their_spectrum_in_0_to_2(
        closed: bool, nu in 3usize..12, nv in 3usize..12, seed: u64,
    ) {
        let level = Level::new(mesh(closed, nu, nv, 0.1, seed));
        let (laplacian, rescaled) = (level.laplacian(), level.rescaled_laplacian());
        prop_assert_eq!(&laplacian.transpose_view().to_csr(), &laplacian);
        prop_assert_eq!(rescaled.nnz(), level.adjacency.nnz());
        for (&value, at) in &laplacian {
            let shifted = rescaled.get(at.0, at.1).copied().unwrap_or(0.0);
            prop_assert_eq!(value, shifted + f64::from(u8::from(at.0 == at.1)));
        }
        // √degree spans the kernel.
        let root: Vec<f64> =
            level.adjacency.outer_iterator().map(|row| (row.nnz() as f64).sqrt()).collect();
        let product = |x: &[f64]| -> Vec<f64> {
            let row = |row: sprs::CsVecView<f64>| row.iter().map(|(j, w)| w * x[j]).sum();
            laplacian.outer_iterator().map(row).collect()
        };
        prop_assert!(product(&root).iter().all(|y| y.abs() < 1e-12));
        // Power iterations on L and on 2 − L meet both ends of the spectrum.
        for flip in [false, true] {
            let mut x: Vec<f64> = (0..root.len()).map(|i| ((i * i + 1) as f64).sin()).collect();
            let mut quotient = 0.0;
            for _ in 0..200 {
                let y = product(&x);
                quotient = x.iter().zip(&y).map(|(x, y)| x * y).sum::<f64>()
                    / x.iter().map(|x| x * x).sum::<f64>();
                prop_assert!((-1e-12..=2.0 + 1e-12).contains(&quotient));
                x = x.iter().zip(&y).map(|(x, y)| if flip { 2.0 * x - y } else { *y }).collect();
                let norm = x.iter().map(|x| x * x).sum::<f64>().sqrt();
                x = x.iter().map(|x| x / norm).collect();
            }
            let reached = if flip { quotient < 0.5 } else { quotient > 1.0 };
            prop_assert!(reached);
        }
    }
}

#[test]
fn the_complete_graph_has_its_known_laplacian() {
    let laplacian = Level::new(tetrahedron()).laplacian();
    for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
        let expected = if i == j { 1.0 } else { -1.0 / 3.0 };
        assert!((laplacian.get(i, j).unwrap() - expected).abs() < 1e-15);
    }
}

#[test]
fn flat_and_folded_meshes_simplify_without_trouble() {
    for noise in [0.0, 1e-17, 1e-9] {
        let surface = mesh(false, 20, 20, noise, 7);
        match MeshPyramid::build(&surface, &[2.0, 2.0, 2.0], Weighting::Barycentric) {
            Ok(pyramid) => {
                for transition in &pyramid.transitions {
                    assert!(transition.up.data().iter().all(|w| (0.0..=1.0).contains(w)));
                }
            }
            Err(error) => assert!(matches!(error, Error::Collapsed { .. }), "{error}"),
        }
    }
}

#[test]
fn a_flat_tip_is_cut_and_the_corner_kept() {
    // An octahedron whose top is pushed down into its flat equator: no plane misses it.
    let mut surface = Surface {
        vertices: vec![
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, 0.0],
            [0.0, 0.0, -1.0],
        ],
        faces: Vec::new(),
    };
    for (a, b) in [(0, 1), (1, 2), (2, 3), (3, 0)] {
        surface.faces.extend([[a, b, 4], [b, a, 5]]);
    }
    let simplified = simplify(&surface, 5).unwrap();
    assert_eq!(simplified.kept, [0, 1, 2, 3, 5]);
    assert_eq!(simplified.surface.faces.len(), 6);
}

#[test]
fn unusable_meshes_are_named() {
    let build = |change: &dyn Fn(&mut Surface), factors: &[f64]| {
        let mut surface = tetrahedron();
        change(&mut surface);
        MeshPyramid::build(surface, factors, Weighting::Barycentric).unwrap_err()
    };
    assert!(matches!(build(&|s| s.faces.clear(), &[]), Error::NoFaces { vertices: 4 }));
    assert!(matches!(
        build(&|s| *s = Surface { vertices: vec![[0.0; 3]; 3], faces: vec![[0, 1, 2]] }, &[]),
        Error::TooFewVertices { vertices: 3 }
    ));
    assert!(matches!(
        build(&|s| s.vertices[2][1] = f64::NAN, &[]),
        Error::NonFinite { vertex: 2, .. }
    ));
    assert!(matches!(
        build(&|s| s.faces[1][2] = 9, &[]),
        Error::FaceOutOfRange { face: 1, vertex: 9, vertices: 4 }
    ));
    assert!(matches!(
        build(&|s| s.faces[2] = [1, 1, 3], &[]),
        Error::DegenerateFace { face: 2, .. }
    ));
    assert!(matches!(
        build(&|s| s.vertices[1] = s.vertices[2], &[]),
        Error::DegenerateFace { face: 0, .. }
    ));
    assert!(matches!(
        build(&|s| s.vertices.extend([[2.0; 3]; 2]), &[]),
        Error::IsolatedVertex { vertex: 4, count: 2 }
    ));
    assert!(matches!(build(&|_| (), &[2.0]), Error::Target { vertices: 4, target: 2 }));
    for value in [0.5, 0.0, -1.0, f64::INFINITY, f64::NAN] {
        assert!(matches!(build(&|_| (), &[1.0, value]), Error::Factor { index: 1, .. }));
    }
    let pieces = |s: &mut Surface| {
        let one = s.clone();
        for piece in 1..5u32 {
            s.vertices.extend(one.vertices.iter().map(|v| add(*v, [2.0; 3], f64::from(piece))));
            s.faces.extend(one.faces.iter().map(|face| face.map(|v| v + 4 * piece)));
        }
    };
    let error = build(&pieces, &[5.0]);
    assert!(matches!(error, Error::Collapsed { vertices: 20, target: 4, .. }), "{error}");
}

#[test]
fn non_manifold_edges_are_accepted_and_counted() {
    let mut surface = mesh(false, 6, 6, 0.05, 3);
    let (a, b) = (14, 15);
    surface.vertices.push([0.4, 0.4, 2.0]);
    surface.faces.push([a, b, 36]);
    let pyramid = MeshPyramid::build(&surface, &[1.5], Weighting::Barycentric).unwrap();
    assert_eq!(pyramid.levels[0].edge_counts().non_manifold, 1);
}

#[test]
fn parts_that_do_not_fit_are_named() {
    let surface = mesh(true, 6, 6, 0.05, 1);
    let pyramid = MeshPyramid::build(&surface, &[2.0, 1.0], Weighting::Barycentric).unwrap();
    let refusal = |change: &dyn Fn(&mut PyramidParts)| {
        let mut parts = parts(&pyramid);
        change(&mut parts);
        MeshPyramid::from_parts(parts).unwrap_err().to_string()
    };
    let expect = |message: String, part: &str| assert!(message.contains(part), "{message}");
    expect(refusal(&|p| drop(p.down.pop())), "`D`");
    expect(refusal(&|p| drop(p.up.pop())), "`U`");
    expect(refusal(&|p| p.faces.push(Vec::new())), "`faces`");
    expect(refusal(&|p| p.adjacency[1] = CsMat::eye(18)), "`A1`: vertex 0 is its own neighbour");
    expect(refusal(&|p| p.adjacency[1] = CsMat::zero((18, 18))), "`A1`: vertex 0 has no neighbour");
    expect(refusal(&|p| p.adjacency[1] = p.adjacency[0].clone()), "`A1`: shape (36, 36)");
    expect(refusal(&|p| p.down[1] = p.down[0].clone()), "`D1`: shape (18, 36)");
    expect(refusal(&|p| p.down[0].scale(2.0)), "`D0`: (0, ");
    expect(refusal(&|p| p.up[0].scale(2.0)), "`U0`: row 0");
    expect(refusal(&|p| p.up[0] = CsMat::zero((36, 18))), "`U0`: row 0 has 0 weights");
    expect(refusal(&|p| p.faces[0].truncate(20)), "`faces 1`: mesh: 4 vertices belong to no face");
    expect(refusal(&|p| drop(p.surface.faces.drain(..2))), "`A0`: its edges are not those");
    expect(
        refusal(&|p| {
            let mut one_way = TriMat::new((36, 36));
            one_way.add_triplet(3, 4, 1.0);
            p.adjacency[0] = one_way.to_csr();
        }),
        "`A0`: (3, 4) is an edge, but (4, 3) is not",
    );

    let mut without_faces = parts(&pyramid);
    without_faces.surface.faces.clear();
    without_faces.faces.clear();
    without_faces.up[1].map_inplace(|w| w + 1e-12);
    let without_faces = MeshPyramid::from_parts(without_faces).unwrap();
    assert_eq!(without_faces.transitions, pyramid.transitions);
    assert_eq!(
        without_faces.levels[2].rescaled_laplacian(),
        pyramid.levels[2].rescaled_laplacian()
    );
}
