//! `smpl/object_arrays/`: the release's pyramid as pickled SciPy matrices.

use std::path::Path;

use burn::tensor::Device;
use cape::{
    core::npy::{Npz, read_objects},
    graph::read_sparse,
};
use sprs::{CsMat, TriMat};

/// Compares `A`, `D` and `U` with the file `pyramid_generator.npz`, which is of the same mesh.
pub(crate) fn check(directory: &Path, _: &Device, report: &mut dyn FnMut(String)) {
    let arrays = directory.join("object_arrays");
    let pyramid = directory.with_file_name("pyramid_generator.npz");
    if !arrays.is_dir() || !pyramid.is_file() {
        report("SKIPPED: no object_arrays/ here, or no pyramid_generator.npz beside".into());
        return;
    }
    let mut pyramid = Npz::open(pyramid).unwrap();
    let mut worst = 0.0_f64;
    let mut counts = Vec::new();
    for name in ["A", "D", "U"] {
        let pickle = read_objects(arrays.join(format!("{name}.npy"))).unwrap();
        let (_, matrices) = pickle.root().objects().unwrap();
        for (level, matrix) in matrices.iter().enumerate() {
            let entries = matrix.sparse().unwrap();
            let [rows, columns] = entries.shape;
            let found: CsMat<f64> = TriMat::from_triplets(
                (rows, columns),
                entries.rows,
                entries.columns,
                entries.values,
            )
            .to_csr();
            let expected = read_sparse(&mut pyramid, &format!("{name}{level}")).unwrap();
            assert_eq!(found.shape(), expected.shape(), "{name}{level}");
            // Adjacency counts edges in more than one way; only the pattern means something.
            let difference = if name == "A" {
                &found.map(|x| f64::from(*x != 0.0)) - &expected.map(|x| f64::from(*x != 0.0))
            } else {
                &found - &expected
            };
            worst = difference.data().iter().fold(worst, |worst, x| worst.max(x.abs()));
        }
        counts.push(format!("{} of {name}", matrices.len()));
    }
    assert!(worst < 1e-5, "an entry is off by {worst:e}");
    report(format!("{} matrices, largest difference {worst:.1e}", counts.join(", ")));
}
