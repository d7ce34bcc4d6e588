#![allow(unsafe_code)] // Register tiles read and write through pointers; every extent is asserted first.

//! Matrix products in register tiles: a block of rows times packed panels, and the sum of outer
//! products of two blocks. The same generic code is compiled for each instruction set, which is
//! selected at run time.

use pulp::{Simd, WithSimd};

use super::{
    bf16::{self, Instructions},
    panels::Panels,
    scratch::with_scratch,
};

/// Depth of a product that is summed in registers before it is written to memory: a panel of this
/// depth fits the first-level cache.
const DEPTH: usize = 512;
/// SIMD vectors in a row of a panel or tile.
const VECTORS: usize = 2;
/// Columns of a packed strip of the left block of [`Packed::outer`]; a multiple of every tile's rows.
const STRIP: usize = 48;
/// Rows of both blocks of [`Packed::outer`] that are packed at once: they fit the second-level cache.
const OUTER_ROWS: usize = 128;
/// The same in bfloat16. The sums, which are read and written once for these rows, take longer than the
/// products if there are few.
const OUTER_ROWS_BF16: usize = 512;

/// Maximal number of rows of one [`product`].
const MOST_ROWS: usize = 128;

/// Number of columns of a panel, which are those of a register tile, on this machine.
pub(super) fn panel_width() -> usize {
    struct Width;
    impl WithSimd for Width {
        type Output = usize;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            width::<S>()
        }
    }
    pulp::Arch::new().dispatch(Width)
}

#[inline(always)]
const fn width<S: Simd>() -> usize {
    // Wide enough for the sums of a tile to hide the latency of their instructions.
    if S::F32_LANES < 8 { 4 * S::F32_LANES } else { VECTORS * S::F32_LANES }
}

/// Rows of a row-major matrix, all or some of them.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a> {
    data: &'a [f32],
    stride: usize,
    len: usize,
    index: Option<&'a [u32]>,
}

impl<'a> Rows<'a> {
    /// All rows, each of `stride` values.
    pub(super) fn new(data: &'a [f32], stride: usize) -> Self {
        Self { data, stride, len: stride, index: None }
    }

    /// All rows, each of `len` values, `stride` apart.
    pub(super) fn strided(data: &'a [f32], stride: usize, len: usize) -> Self {
        Self { data, stride, len, index: None }
    }

    /// The rows at `index`; all rows for `None`.
    pub(super) fn selected(data: &'a [f32], stride: usize, index: Option<&'a [u32]>) -> Self {
        Self { data, stride, len: stride, index }
    }

    /// Number of values of a row.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Row `i`.
    #[inline(always)]
    pub(super) fn row(&self, i: usize) -> &'a [f32] {
        let row = self.index.map_or(i, |index| index[i] as usize);
        &self.data[row * self.stride..][..self.len]
    }

    /// The rows from `first` on.
    pub(super) fn from(self, first: usize) -> Self {
        match self.index {
            Some(index) => Self { index: Some(&index[first..]), ..self },
            None => Self { data: &self.data[first * self.stride..], ..self },
        }
    }
}

/// Bias and activation of a complete product.
#[derive(Clone, Copy, Default)]
pub(super) struct Epilogue<'a> {
    /// Added to every row, `[columns]`.
    pub bias: Option<&'a [f32]>,
    /// Negative slope of a leaky ReLU.
    pub slope: Option<f32>,
}

/// `out = epilogue(a b)` or, if `add`, `out = epilogue(out + a b)`; `a: [rows, depth]`,
/// `out: [rows, columns]`, row-major, at most [`MOST_ROWS`] rows.
pub(super) fn product(a: Rows, b: &Panels, add: bool, epilogue: Epilogue, out: &mut [f32]) {
    assert!(
        a.stride == b.depth() && b.columns() > 0 && out.len().is_multiple_of(b.columns()),
        "rows of {} and panels of [{}, {}]",
        a.stride,
        b.depth(),
        b.columns()
    );
    assert!(out.len() <= MOST_ROWS * b.columns(), "at most {MOST_ROWS} rows at a time");
    assert!(epilogue.bias.is_none_or(|bias| bias.len() == b.columns()));
    if let Some((right, by)) = b.bf16() {
        let (depth, columns) = (b.depth(), b.columns());
        let rows = out.len() / columns;
        with_scratch(bf16::left_size(rows, depth), |left| {
            bf16::pack_left(by, a, rows, left);
            let factors = bf16::Factors { left, right, rows, depth, columns };
            factors.multiply(by, add, epilogue, out, columns);
        });
        return;
    }
    pulp::Arch::new().dispatch(Product { a, b, add, epilogue, out });
}

struct Product<'a> {
    a: Rows<'a>,
    b: &'a Panels,
    add: bool,
    epilogue: Epilogue<'a>,
    out: &'a mut [f32],
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            16 => self.run::<S, 8, VECTORS>(simd),
            8 => self.run::<S, 6, VECTORS>(simd),
            _ => self.run::<S, 4, 4>(simd),
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn run<S: Simd, const ROWS: usize, const VECTORS: usize>(self, simd: S) {
        let Self { a, b, add, epilogue, out } = self;
        let (depth, columns) = (b.depth(), b.columns());
        let rows = out.len() / columns;
        let mut starts = [std::ptr::null::<f32>(); MOST_ROWS];
        for (i, start) in starts.iter_mut().enumerate().take(rows) {
            *start = a.row(i).as_ptr();
        }
        let mut tails = [[0.0f32; TAIL]; ROWS];
        for k in (0..depth.max(1)).step_by(DEPTH) {
            let deep = DEPTH.min(depth - k);
            let add = add || k > 0;
            let epilogue = if k + deep == depth { epilogue } else { Epilogue::default() };
            for (panel, start) in (0..columns).step_by(width::<S>()).enumerate() {
                let wide = width::<S>().min(columns - start);
                let panel = &b.panel(panel)[k * width::<S>()..][..deep * width::<S>()];
                for first in (0..rows).step_by(ROWS) {
                    let tall = ROWS.min(rows - first);
                    let out = &mut out[first * columns + start..];
                    assert!(out.len() >= (tall - 1) * columns + wide);
                    // SAFETY: every row starts a slice of `depth` floats, `deep` of them from `k`
                    // on, and the panel has `deep` rows by its slice; `tall` rows of `wide` floats
                    // of the output are in its slice by the assertion, and tails are wider than a
                    // tile.
                    unsafe {
                        // Rows past the last repeat it; their sums are dropped.
                        let left: [*const f32; ROWS] = std::array::from_fn(
                            #[inline(always)]
                            |i| starts[first + i.min(tall - 1)].add(k),
                        );
                        let sums = tile::<S, ROWS, VECTORS>(simd, deep, left, 1, panel.as_ptr());
                        if wide == width::<S>() {
                            let bias = epilogue.bias.map(|bias| bias[start..][..wide].as_ptr());
                            let to = Tile { data: out.as_mut_ptr(), stride: columns, rows: tall };
                            write(simd, &sums, to, add, bias, epilogue.slope);
                        } else {
                            write(simd, &sums, Tile::whole(&mut tails), false, None, None);
                            for (i, tail) in tails.iter().enumerate().take(tall) {
                                let out = &mut out[i * columns..][..wide];
                                for (j, (out, tail)) in out.iter_mut().zip(tail).enumerate() {
                                    let sum = if add { *out + tail } else { *tail };
                                    let bias = epilogue.bias.map(|bias| bias[start + j]);
                                    let sum = bias.map_or(sum, |bias| sum + bias);
                                    let slope = epilogue.slope.unwrap_or(1.0);
                                    *out = if sum > 0.0 { sum } else { slope * sum };
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Two blocks with the same number of rows, packed for [`outer`](Self::outer), in f32 or as factors of
/// [`bf16`].
pub(super) struct Packed<'a> {
    /// `[left / STRIP][rows][STRIP]` in f32.
    left: &'a mut [f32],
    left_columns: usize,
    /// `[right / width][rows][width]` in f32.
    right: &'a mut [f32],
    right_columns: usize,
    by: Option<Instructions>,
}

impl<'a> Packed<'a> {
    /// Maximal number of rows of a block.
    pub(super) fn most_rows(by: Option<Instructions>) -> usize {
        if by.is_some() { OUTER_ROWS_BF16 } else { OUTER_ROWS }
    }

    /// Number of floats of scratch memory for blocks of `left` and `right` columns.
    pub(super) fn scratch(left: usize, right: usize, by: Option<Instructions>) -> usize {
        let right = match by {
            Some(_) => bf16::right_size(OUTER_ROWS_BF16, right),
            None => right.next_multiple_of(panel_width()) * OUTER_ROWS,
        };
        Self::left_size(left, by) + right
    }

    fn left_size(columns: usize, by: Option<Instructions>) -> usize {
        match by {
            Some(_) => bf16::left_size(columns, OUTER_ROWS_BF16),
            None => columns.next_multiple_of(STRIP) * OUTER_ROWS,
        }
    }

    /// Blocks of up to [`most_rows`](Self::most_rows) rows in `scratch`, in bfloat16 for the instructions
    /// `by`, if any.
    pub(super) fn new(
        scratch: &'a mut [f32],
        left_columns: usize,
        right_columns: usize,
        by: Option<Instructions>,
    ) -> Self {
        let (left, right) = scratch.split_at_mut(Self::left_size(left_columns, by));
        Self { left, left_columns, right, right_columns, by }
    }

    /// Packs `rows` rows of the left block.
    pub(super) fn pack_left(&mut self, rows: usize, source: Rows) {
        match self.by {
            Some(by) => bf16::pack_transposed_left(by, source, rows, self.left),
            None => pack::<STRIP>(self.left, self.left_columns, rows, source),
        }
    }

    /// Packs `rows` rows of the right block.
    pub(super) fn pack_right(&mut self, rows: usize, source: Rows) {
        let (right, columns) = (&mut *self.right, self.right_columns);
        if let Some(by) = self.by {
            bf16::pack_right(by, source, rows, right);
            return;
        }
        match panel_width() {
            32 => pack::<32>(right, columns, rows, source),
            16 => pack::<16>(right, columns, rows, source),
            _ => pack::<4>(right, columns, rows, source),
        }
    }

    /// `out[i · stride + j] += Σ_r left[r, i] right[r, j]` over the `rows` packed rows.
    pub(super) fn outer(&self, rows: usize, stride: usize, out: &mut [f32]) {
        assert!(
            (1..=Self::most_rows(self.by)).contains(&rows)
                && self.right_columns <= stride
                && (self.left_columns - 1) * stride + self.right_columns <= out.len(),
            "outer product of [{rows}, {}] and [{rows}, {}] with rows {stride} apart",
            self.left_columns,
            self.right_columns,
        );
        let (left, right) = (&*self.left, &*self.right);
        if let Some(by) = self.by {
            let (rows, depth, columns) = (self.left_columns, rows, self.right_columns);
            let factors = bf16::Factors { left, right, rows, depth, columns };
            factors.multiply(by, true, Epilogue::default(), out, stride);
            return;
        }
        pulp::Arch::new().dispatch(Outer { packed: self, rows, stride, out });
    }
}

fn pack<const WIDTH: usize>(packed: &mut [f32], columns: usize, rows: usize, source: Rows) {
    assert!(rows <= OUTER_ROWS && source.stride == columns);
    for r in 0..rows {
        let (chunks, rest) = source.row(r).as_chunks::<WIDTH>();
        let strips = packed.chunks_exact_mut(rows * WIDTH);
        for (chunk, strip) in chunks.iter().zip(strips) {
            strip[r * WIDTH..][..WIDTH].copy_from_slice(chunk);
        }
        if !rest.is_empty() {
            let strip = &mut packed[chunks.len() * rows * WIDTH + r * WIDTH..][..WIDTH];
            strip[..rest.len()].copy_from_slice(rest);
            strip[rest.len()..].fill(0.0);
        }
    }
}

struct Outer<'a> {
    packed: &'a Packed<'a>,
    rows: usize,
    stride: usize,
    out: &'a mut [f32],
}

impl WithSimd for Outer<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            16 => self.run::<S, 8, VECTORS>(simd),
            8 => self.run::<S, 6, VECTORS>(simd),
            _ => self.run::<S, 4, 4>(simd),
        }
    }
}

impl Outer<'_> {
    #[inline(always)]
    fn run<S: Simd, const ROWS: usize, const VECTORS: usize>(self, simd: S) {
        let Self { packed, rows, stride, out } = self;
        let (left_columns, right_columns) = (packed.left_columns, packed.right_columns);
        let mut tails = [[0.0f32; TAIL]; ROWS];
        for (panel, start) in (0..right_columns).step_by(width::<S>()).enumerate() {
            let wide = width::<S>().min(right_columns - start);
            let size = rows * width::<S>();
            let right = &packed.right[panel * size..][..size];
            for first in (0..left_columns).step_by(ROWS) {
                let tall = ROWS.min(left_columns - first);
                let strip = &packed.left[first / STRIP * rows * STRIP..][..rows * STRIP];
                let left = &strip[first % STRIP..];
                assert!(left.len() >= (rows - 1) * STRIP + ROWS);
                let out = &mut out[first * stride + start..];
                assert!(out.len() >= (tall - 1) * stride + wide);
                // SAFETY: `rows` left floats, `STRIP` apart, from each of `ROWS` starts, and
                // `rows` rows of the right panel are in their slices, by the assertion and the
                // slice; likewise the output. Tails are wider than a tile.
                unsafe {
                    for i in 0..tall {
                        prefetch(out.as_ptr().add(i * stride));
                    }
                    let starts: [*const f32; ROWS] = std::array::from_fn(|i| left.as_ptr().add(i));
                    let sums = tile::<S, ROWS, VECTORS>(simd, rows, starts, STRIP, right.as_ptr());
                    if wide == width::<S>() {
                        let to = Tile { data: out.as_mut_ptr(), stride, rows: tall };
                        write(simd, &sums, to, true, None, None);
                    } else {
                        write(simd, &sums, Tile::whole(&mut tails), false, None, None);
                        for (i, tail) in tails.iter().enumerate().take(tall) {
                            for (out, tail) in out[i * stride..][..wide].iter_mut().zip(tail) {
                                *out += tail;
                            }
                        }
                    }
                }
            }
        }
    }
}

/// `Σ_k left[i][k · step] · right[k]` in registers, `right: [depth, VECTORS]` vectors.
///
/// # Safety
/// `depth` floats, `step` apart, must be readable from each left pointer, and `depth` rows from
/// `right`.
#[inline(always)]
unsafe fn tile<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    depth: usize,
    left: [*const f32; ROWS],
    step: usize,
    right: *const f32,
) -> [[S::f32s; VECTORS]; ROWS] {
    let mut sums = [[simd.splat_f32s(0.0); VECTORS]; ROWS];
    let mut right = right.cast::<S::f32s>();
    let mut at = 0;
    for _ in 0..depth {
        // SAFETY: in bounds by this function's contract.
        unsafe {
            let row: [S::f32s; VECTORS] = std::array::from_fn(|j| right.add(j).read_unaligned());
            for i in 0..ROWS {
                let number = simd.splat_f32s(*left[i].add(at));
                for j in 0..VECTORS {
                    sums[i][j] = simd.mul_add_e_f32s(number, row[j], sums[i][j]);
                }
            }
            right = right.add(VECTORS);
        }
        at += step;
    }
    sums
}

/// Place of a register tile in memory.
#[derive(Clone, Copy)]
struct Tile {
    data: *mut f32,
    /// Distance between rows, in floats.
    stride: usize,
    /// Number of rows.
    rows: usize,
}

/// Columns of the memory for tiles at the right edge of a matrix; more than any register tile has.
const TAIL: usize = 64;

impl Tile {
    /// All rows of `tails`.
    #[inline(always)]
    fn whole<const ROWS: usize>(tails: &mut [[f32; TAIL]; ROWS]) -> Self {
        Self { data: tails.as_mut_ptr().cast(), stride: TAIL, rows: ROWS }
    }
}

/// Overwrites or, if `add`, adds to the rows of a tile, followed by bias and leaky ReLU.
///
/// # Safety
/// `VECTORS` vectors must be writable in every row of `to`, and readable from `bias`.
#[inline(always)]
unsafe fn write<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    sums: &[[S::f32s; VECTORS]; ROWS],
    to: Tile,
    add: bool,
    bias: Option<*const f32>,
    slope: Option<f32>,
) {
    let zero = simd.splat_f32s(0.0);
    for (i, sums) in sums.iter().enumerate() {
        if i < to.rows {
            for (j, &sum) in sums.iter().enumerate() {
                // SAFETY: in bounds by this function's contract.
                unsafe {
                    let out = to.data.add(i * to.stride).cast::<S::f32s>().add(j);
                    let mut sum = sum;
                    if add {
                        sum = simd.add_f32s(sum, out.read_unaligned());
                    }
                    if let Some(bias) = bias {
                        let bias = bias.cast::<S::f32s>().add(j).read_unaligned();
                        sum = simd.add_f32s(sum, bias);
                    }
                    if let Some(slope) = slope {
                        let scaled = simd.mul_f32s(sum, simd.splat_f32s(slope));
                        let positive = simd.greater_than_f32s(sum, zero);
                        sum = simd.select_f32s(positive, sum, scaled);
                    }
                    out.write_unaligned(sum);
                }
            }
        }
    }
}

/// Prefetches a cache line.
#[inline(always)]
fn prefetch(at: *const f32) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a prefetch of any address has no effect but on the cache.
    unsafe {
        std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(at.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = at;
}
