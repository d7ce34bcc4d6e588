use half::bf16;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use super::{super::kernel::Packed, *};

/// Extents `[rows, depth, columns]`: whole blocks, parts of blocks, a row, a column, a layer's.
const EXTENTS: [[usize; 3]; 8] = [
    [32, 32, 32],
    [1, 1, 1],
    [1, 70, 33],
    [31, 17, 16],
    [64, 96, 48],
    [96, 64, 128],
    [128, 130, 65],
    [74, 512, 256],
];

struct Matrix {
    columns: usize,
    values: Vec<f32>,
}

impl Matrix {
    fn random(rows: usize, columns: usize, rng: &mut ChaCha8Rng) -> Self {
        Self { columns, values: (0..rows * columns).map(|_| rng.random_range(-1.0..1.0)).collect() }
    }

    /// The number that a product sees.
    fn rounded(&self, row: usize, column: usize) -> f64 {
        f64::from(bf16::from_f32(self.values[row * self.columns + column]).to_f32())
    }
}

/// Largest difference from `expected`, relative to the sum of the terms' magnitudes.
fn error(found: &[f32], expected: impl Fn(usize) -> (f64, f64)) -> f64 {
    let relative = |(i, found): (usize, &f32)| {
        let (value, magnitude) = expected(i);
        (f64::from(*found) - value).abs() / magnitude.max(1.0)
    };
    found.iter().enumerate().map(relative).fold(0.0, f64::max)
}

#[test]
fn products_are_those_of_rounded_numbers() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for by in all() {
        for [rows, depth, columns] in EXTENTS {
            let (a, b) =
                (Matrix::random(rows, depth, &mut rng), Matrix::random(depth, columns, &mut rng));
            let before = Matrix::random(rows, columns, &mut rng);
            let bias = Matrix::random(1, columns, &mut rng).values;
            let mut left = vec![f32::NAN; left_size(rows, depth)];
            pack_left(by, Rows::new(&a.values, depth), rows, &mut left);
            let view = View {
                data: &b.values,
                rows: depth,
                columns,
                row_stride: columns,
                column_stride: 1,
            };
            let right = pack_panels(by, view);
            // The transpose of the transpose, whose columns are contiguous.
            let mut turned = vec![0.0; b.values.len()];
            for k in 0..depth {
                for j in 0..columns {
                    turned[j * depth + k] = b.values[k * columns + j];
                }
            }
            let view = View {
                data: &turned,
                rows: columns,
                columns: depth,
                row_stride: depth,
                column_stride: 1,
            };
            assert_eq!(
                &*pack_panels(by, view.transposed()),
                &*right,
                "{by:?} [{depth}, {columns}]"
            );

            let factors = Factors { left: &left, right: &right, rows, depth, columns };
            let sum = |i: usize| {
                let terms =
                    (0..depth).map(|k| a.rounded(i / columns, k) * b.rounded(k, i % columns));
                terms.fold((0.0, 0.0), |(sum, size), term| (sum + term, size + term.abs()))
            };
            let mut out = before.values.clone();
            factors.multiply(by, false, Epilogue::default(), &mut out, columns);
            let off = error(&out, sum);
            assert!(off < 2e-6, "{by:?} [{rows}, {depth}, {columns}]: {off:.1e}");

            let mut out = before.values.clone();
            let epilogue = Epilogue { bias: Some(&bias), slope: Some(0.2) };
            factors.multiply(by, true, epilogue, &mut out, columns);
            let off = error(&out, |i| {
                let (value, size) = sum(i);
                let value = value + f64::from(before.values[i]) + f64::from(bias[i % columns]);
                (if value > 0.0 { value } else { 0.2 * value }, size)
            });
            assert!(off < 2e-6, "{by:?} [{rows}, {depth}, {columns}] with epilogue: {off:.1e}");
        }
    }
}

#[test]
fn outer_products_are_those_of_rounded_numbers() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for by in all() {
        for [left_columns, rows, columns] in EXTENTS {
            let rows = rows.min(Packed::most_rows(Some(by)));
            let stride = columns + 3;
            let (a, b) = (
                Matrix::random(rows, left_columns, &mut rng),
                Matrix::random(rows, columns, &mut rng),
            );
            let before = Matrix::random(left_columns, stride, &mut rng).values;
            let mut scratch = vec![f32::NAN; Packed::scratch(left_columns, columns, Some(by))];
            let mut packed = Packed::new(&mut scratch, left_columns, columns, Some(by));
            packed.pack_left(rows, Rows::new(&a.values, left_columns));
            packed.pack_right(rows, Rows::new(&b.values, columns));
            let mut out = before.clone();
            packed.outer(rows, stride, &mut out);
            let off = error(&out, |i| {
                let (row, column) = (i / stride, i % stride);
                let start = f64::from(before[i]);
                if column >= columns {
                    return (start, 0.0);
                }
                let terms = (0..rows).map(|r| a.rounded(r, row) * b.rounded(r, column));
                terms.fold((start, 0.0), |(sum, size), term| (sum + term, size + term.abs()))
            });
            assert!(off < 2e-6, "{by:?} [{left_columns}, {rows}, {columns}]: {off:.1e}");
        }
    }
}
