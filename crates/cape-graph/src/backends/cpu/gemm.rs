#![allow(unsafe_code)] // `gemm::gemm` takes pointers and strides; every extent is asserted here.

/// A matrix in a slice, with the distances between rows and between columns.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    data: &'a [f32],
    rows: usize,
    cols: usize,
    row_stride: usize,
    col_stride: usize,
}

impl<'a> View<'a> {
    /// A row-major matrix without gaps.
    pub(super) fn new(data: &'a [f32], rows: usize, cols: usize) -> Self {
        Self::strided(data, rows, cols, cols)
    }

    /// A row-major matrix whose rows are `stride` apart.
    pub(super) fn strided(data: &'a [f32], rows: usize, cols: usize, stride: usize) -> Self {
        Self { data, rows, cols, row_stride: stride, col_stride: 1 }
    }

    pub(super) fn transposed(self) -> Self {
        Self {
            rows: self.cols,
            cols: self.rows,
            row_stride: self.col_stride,
            col_stride: self.row_stride,
            ..self
        }
    }

    fn fits(&self) -> bool {
        let last = |n: usize, stride: usize| (n - 1) * stride;
        self.rows == 0
            || self.cols == 0
            || last(self.rows, self.row_stride) + last(self.cols, self.col_stride) < self.data.len()
    }
}

/// `out = a b`, or `out += a b` to `add`; `out` is row-major with rows `stride` apart. Threads are
/// used if `threaded`.
pub(super) fn product(a: View, b: View, out: &mut [f32], stride: usize, add: bool, threaded: bool) {
    let result = View::strided(out, a.rows, b.cols, stride);
    assert!(
        a.cols == b.rows && b.cols <= stride && a.fits() && b.fits() && result.fits(),
        "product of [{}, {}] and [{}, {}]",
        a.rows,
        a.cols,
        b.rows,
        b.cols
    );
    let parallelism = if threaded { gemm::Parallelism::Rayon(0) } else { gemm::Parallelism::None };
    // SAFETY: the assertion keeps every access of the three strided matrices inside its slice, and
    // `out` is borrowed mutably, so it overlaps neither.
    unsafe {
        gemm::gemm(
            a.rows,
            b.cols,
            a.cols,
            out.as_mut_ptr(),
            1,
            stride as isize,
            add,
            a.data.as_ptr(),
            a.col_stride as isize,
            a.row_stride as isize,
            b.data.as_ptr(),
            b.col_stride as isize,
            b.row_stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            parallelism,
        );
    }
}
