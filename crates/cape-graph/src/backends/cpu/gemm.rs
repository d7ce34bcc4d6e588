#![allow(unsafe_code)] // `gemm::gemm` takes pointers and strides; every extent is asserted here.

/// A row-major view: `rows × cols`, consecutive rows `stride` apart.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub data: &'a [f32],
    pub rows: usize,
    pub cols: usize,
    pub stride: usize,
}

impl<'a> View<'a> {
    pub(super) fn new(data: &'a [f32], rows: usize, cols: usize) -> Self {
        Self { data, rows, cols, stride: cols }
    }
}

fn fits(len: usize, rows: usize, cols: usize, stride: usize) -> bool {
    rows == 0 || cols == 0 || (cols <= stride && (rows - 1) * stride + cols <= len)
}

fn parallelism(threaded: bool) -> gemm::Parallelism {
    if threaded { gemm::Parallelism::Rayon(0) } else { gemm::Parallelism::None }
}

/// `out (+)= a b`, where `out` is `[a.rows, b.cols]` with rows `stride` apart.
pub(super) fn product(a: View, b: View, out: &mut [f32], stride: usize, add: bool, threaded: bool) {
    assert!(
        a.cols == b.rows
            && fits(a.data.len(), a.rows, a.cols, a.stride)
            && fits(b.data.len(), b.rows, b.cols, b.stride)
            && fits(out.len(), a.rows, b.cols, stride)
    );
    // SAFETY: the assertion keeps every access of the three strided matrices inside its slice.
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
            1,
            a.stride as isize,
            b.data.as_ptr(),
            1,
            b.stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            parallelism(threaded),
        );
    }
}

/// `out (+)= a bᵀ`, where `out` is `[a.rows, b.rows]`, contiguous.
pub(super) fn product_b_transposed(a: View, b: View, out: &mut [f32], threaded: bool) {
    assert!(
        a.cols == b.cols
            && fits(a.data.len(), a.rows, a.cols, a.stride)
            && fits(b.data.len(), b.rows, b.cols, b.stride)
            && fits(out.len(), a.rows, b.rows, b.rows)
    );
    // SAFETY: as in `product`; the right matrix is read with its strides exchanged.
    unsafe {
        gemm::gemm(
            a.rows,
            b.rows,
            a.cols,
            out.as_mut_ptr(),
            1,
            b.rows as isize,
            false,
            a.data.as_ptr(),
            1,
            a.stride as isize,
            b.data.as_ptr(),
            b.stride as isize,
            1,
            1.0,
            1.0,
            false,
            false,
            false,
            parallelism(threaded),
        );
    }
}

/// `out += aᵀ b`, where `out` is `[a.cols, b.cols]` with rows `stride` apart.
pub(super) fn add_a_transposed_product(
    a: View,
    b: View,
    out: &mut [f32],
    stride: usize,
    threaded: bool,
) {
    assert!(
        a.rows == b.rows
            && fits(a.data.len(), a.rows, a.cols, a.stride)
            && fits(b.data.len(), b.rows, b.cols, b.stride)
            && fits(out.len(), a.cols, b.cols, stride)
    );
    // SAFETY: as in `product`; the left matrix is read with its strides exchanged.
    unsafe {
        gemm::gemm(
            a.cols,
            b.cols,
            a.rows,
            out.as_mut_ptr(),
            1,
            stride as isize,
            true,
            a.data.as_ptr(),
            a.stride as isize,
            1,
            b.data.as_ptr(),
            1,
            b.stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            parallelism(threaded),
        );
    }
}
