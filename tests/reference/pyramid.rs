//! `pyramid_*.npz`: what the original simplification made of a mesh.

use std::{collections::BTreeSet, path::Path, time::Instant};

use burn::tensor::Device;
use cape::core::npy::Npz;
use cape::graph::{MeshPyramid, Surface, Weighting, read_sparse};
use sprs::CsMat;

/// Largest distance between points that `U` gives here and there, metres.
const TOLERANCE: f64 = 1e-6;

/// Builds the pyramid of the file's finest mesh and compares every level with the file's: the same
/// vertices kept, the same faces up to rotation, and `U` giving the same points.
pub(crate) fn check(path: &Path, _: &Device, report: &mut dyn FnMut(String)) {
    let file = &mut Npz::open(path).unwrap();
    let factors: Vec<f64> = file.f64("factors").unwrap().into_iter().collect();
    let finest = read_surface(file, 0);
    let start = Instant::now();
    let pyramid = MeshPyramid::build(&finest, &factors, Weighting::Release).unwrap();
    let seconds = start.elapsed().as_secs_f64();

    let mut deviation = 0.0_f64;
    let name = path.display();
    for (i, transition) in pyramid.transitions().iter().enumerate() {
        let coarse = pyramid.levels()[i + 1].surface();
        let expected = read_surface(file, i + 1);
        let selection = read_sparse(file, &format!("D{i}")).unwrap();
        assert!(transition.down_matrix() == selection, "{name}: D{i} keeps other vertices");
        assert_eq!(face_set(coarse), face_set(&expected), "{name}: faces of level {}", i + 1);
        let up = read_sparse(file, &format!("U{i}")).unwrap();
        let (ours, theirs) = (interpolate(transition.up(), coarse), interpolate(&up, &expected));
        for (a, b) in ours.iter().zip(&theirs) {
            let squared: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
            deviation = deviation.max(squared.sqrt());
        }
    }
    assert!(deviation <= TOLERANCE, "{name}: U is off by {deviation:e} m");
    let non_manifold: Vec<usize> =
        pyramid.levels().iter().map(|level| level.edge_counts().non_manifold).collect();
    report(format!(
        "vertices and faces the same at all {} levels, U within {deviation:.1e} m, \
         built in {seconds:.3} s, non-manifold edges {non_manifold:?}",
        pyramid.levels().len()
    ));
}

fn read_surface(file: &mut Npz, level: usize) -> Surface {
    let vertices: Vec<f64> = file.f64(&format!("v{level}")).unwrap().into_iter().collect();
    let faces = file.i64(&format!("f{level}")).unwrap();
    let faces: Vec<u32> = faces.into_iter().map(|vertex| vertex.try_into().unwrap()).collect();
    Surface { vertices: vertices.as_chunks().0.to_vec(), faces: faces.as_chunks().0.to_vec() }
}

/// Faces, each starting at its smallest index.
fn face_set(surface: &Surface) -> BTreeSet<[u32; 3]> {
    let first = |[a, b, c]: [u32; 3]| [[a, b, c], [b, c, a], [c, a, b]].into_iter().min();
    surface.faces.iter().copied().filter_map(first).collect()
}

fn interpolate(up: &CsMat<f64>, coarse: &Surface) -> Vec<[f64; 3]> {
    let point = |row: Vec<(usize, f64)>| {
        std::array::from_fn(|axis| row.iter().map(|&(j, w)| w * coarse.vertices[j][axis]).sum())
    };
    up.outer_iterator().map(|row| point(row.iter().map(|(j, &w)| (j, w)).collect())).collect()
}
