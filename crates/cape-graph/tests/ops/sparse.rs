use burn::tensor::{Device, Tensor};
use cape_graph::{SparseMatrix, sparse_matmul};
use proptest::prelude::*;
use sprs::CsMat;

use crate::{
    host,
    support::{
        assert_agree, assert_close, cpu_devices, devices, is_cpu, random, run, sparse, upload,
        values,
    },
};

/// Batch, rows, columns, channels.
const SIZES: [(usize, usize, usize, usize); 9] = [
    (1, 1, 1, 1),
    (1, 7, 7, 1),
    (2, 5, 11, 2),
    (3, 301, 13, 3),
    (5, 17, 257, 7),
    (11, 33, 65, 16),
    (2, 259, 129, 33),
    (1, 515, 513, 64),
    (2, 37, 41, 544),
];

/// Dense matrix, `[1, rows, columns]`.
pub(crate) fn dense(matrix: &CsMat<f64>, device: &Device) -> Tensor<3> {
    let mut values = vec![0.0; matrix.rows() * matrix.cols()];
    for (&value, (row, col)) in matrix {
        values[row * matrix.cols() + col] = value;
    }
    upload(&values, [1, matrix.rows(), matrix.cols()], device)
}

pub(crate) fn dense_matmul(x: Tensor<3>, dense: &Tensor<3>) -> Tensor<3> {
    let [batch, _, _] = x.dims();
    let [_, rows, cols] = dense.dims();
    dense.clone().expand([batch, rows, cols]).matmul(x)
}

#[test]
fn agrees_with_a_dense_product() {
    for (name, device) in devices() {
        for (batch, rows, cols, channels) in SIZES {
            if channels > 64 && !is_cpu(&name) {
                continue;
            }
            for gaps in [false, true] {
                let label = format!("{name}: [{batch}, {rows}×{cols}, {channels}], gaps {gaps}");
                let matrix = sparse(1, rows, cols, 4, gaps);
                let (a, full) = (
                    SparseMatrix::new(&matrix, &device),
                    dense(&matrix, &device.clone().autodiff()),
                );
                let inputs = [random(2, batch * cols * channels)];
                let shape = [batch, cols, channels];
                let fused = run(&device, &inputs, &[true], &|x| {
                    sparse_matmul(x[0].clone().reshape(shape), &a)
                });
                let composed = run(&device, &inputs, &[true], &|x| {
                    dense_matmul(x[0].clone().reshape(shape), &full)
                });
                assert_agree(&label, &fused, &composed, 2e-6);
            }
        }
    }
}

#[test]
fn agrees_with_finite_differences() {
    for (name, device) in devices() {
        for (batch, rows, cols, channels) in [(1, 3, 5, 1), (2, 7, 4, 3), (9, 5, 5, 2)] {
            let matrix = sparse(3, rows, cols, 2, true);
            let a = SparseMatrix::new(&matrix, &device);
            let inputs = [random(4, batch * cols * channels)];
            let shape = [batch, cols, channels];
            let outcome =
                run(&device, &inputs, &[true], &|x| sparse_matmul(x[0].clone().reshape(shape), &a));
            crate::support::assert_host(&name, &outcome, &inputs, &|x| {
                host::sparse_matmul(&x[0], &matrix, channels)
            });
        }
    }
}

/// Name of a view, number of its values, and its arrangement of a flat tensor.
type View<'a> = (&'a str, usize, &'a (dyn Fn(Tensor<1>) -> Tensor<3> + Sync));

#[test]
fn takes_strided_inputs() {
    let (batch, vertices, channels) = (3, 13, 5);
    let matrix = sparse(5, 9, vertices, 3, false);
    for (name, device) in devices() {
        let (a, full) =
            (SparseMatrix::new(&matrix, &device), dense(&matrix, &device.clone().autodiff()));
        let views: [View; 3] = [
            ("swapped", batch * vertices * channels, &|x| {
                x.reshape([batch, channels, vertices]).swap_dims(1, 2)
            }),
            ("sliced", (batch + 2) * (vertices + 3) * (channels + 1), &|x| {
                let x = x.reshape([batch + 2, vertices + 3, channels + 1]);
                x.slice([2..batch + 2, 3..vertices + 3, 0..channels])
            }),
            ("expanded", vertices * channels, &|x| {
                x.reshape([1, vertices, channels]).expand([batch, vertices, channels])
            }),
        ];
        for (view, len, shaped) in views {
            let inputs = [random(6, len)];
            let fused =
                run(&device, &inputs, &[true], &|x| sparse_matmul(shaped(x[0].clone()), &a));
            let composed =
                run(&device, &inputs, &[true], &|x| dense_matmul(shaped(x[0].clone()), &full));
            assert_agree(&format!("{name}: {view}"), &fused, &composed, 2e-6);
        }
    }
}

#[test]
fn takes_compressed_columns() {
    let rows = sparse(7, 8, 6, 3, true);
    let x = random(8, 2 * 6 * 3);
    for (_, device) in devices() {
        let multiply = |matrix: &CsMat<f64>| {
            let x = upload(&x, [2, 6, 3], &device);
            values(sparse_matmul(x, &SparseMatrix::new(matrix, &device)))
        };
        assert_eq!(multiply(&rows), multiply(&rows.to_csc()));
    }
}

#[test]
#[should_panic(expected = "sparse_matmul: x has 4 vertices but the matrix is [3, 5]")]
fn refuses_other_vertices() {
    let (_, device) = devices().swap_remove(0);
    let a = SparseMatrix::new(&sparse(1, 3, 5, 1, false), &device);
    sparse_matmul(Tensor::zeros([1, 4, 2], &device), &a);
}

proptest! {
    #[test]
    fn transpose_is_the_adjoint(
        seed in any::<u64>(),
        batch in 1usize..12,
        rows in 1usize..40,
        cols in 1usize..40,
        channels in 1usize..9,
        per_row in 0usize..6,
        gaps in any::<bool>(),
    ) {
        let matrix = sparse(seed, rows, cols, per_row, gaps);
        let x = random(seed ^ 1, batch * cols * channels);
        let y = random(seed ^ 2, batch * rows * channels);
        let dot = |a: &[f32], b: &[f64]| -> f64 {
            a.iter().zip(b).map(|(&a, b)| f64::from(a) * b).sum()
        };
        for (name, device) in cpu_devices() {
            let multiply = |matrix: &CsMat<f64>, x: &[f64]| {
                let x = upload(x, [batch, matrix.cols(), channels], &device);
                values(sparse_matmul(x, &SparseMatrix::new(matrix, &device)))
            };
            let ax = multiply(&matrix, &x);
            let aty = multiply(&matrix.transpose_view().to_csr(), &y);
            let size = (x.len() * y.len()) as f64;
            prop_assert!((dot(&ax, &y) - dot(&aty, &x)).abs() <= 1e-6 * size.sqrt(), "{}", name);
            assert_close(&name, &ax, &host::sparse_matmul(&x, &matrix, channels), 2e-6);
        }
    }
}
