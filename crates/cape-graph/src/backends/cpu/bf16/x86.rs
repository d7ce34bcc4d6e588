#![allow(unsafe_code)] // Instructions of the processor on raw memory; every extent is asserted first.

//! Packing and products by AVX-512 BF16 and AMX. Every function but [`all`] has an argument
//! [`Instructions`], which exist only where `all` has found them.

#[allow(clippy::wildcard_imports, reason = "names of instructions, which are unique")]
use std::arch::{asm, x86_64::*};

use super::{super::kernel::Rows, BLOCK, Instructions, PANEL, Place};

/// All instructions of this processor, fastest first.
pub(super) fn all() -> Vec<Instructions> {
    let vectors = is_x86_feature_detected!("avx512bf16")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512f");
    if !vectors {
        return Vec::new();
    }
    let mut found = Vec::new();
    if tiles() {
        found.push(Instructions::Amx);
    }
    found.push(Instructions::Avx512);
    found
}

/// True if the processor has tiles of bfloat16 and the system lets this process use them.
fn tiles() -> bool {
    // Leaf 7: bit 22 for AMX-BF16, 24 for AMX-TILE.
    const BF16_AND_TILE: u32 = 1 << 22 | 1 << 24;
    let (leaf, _) = __get_cpuid_max(0);
    leaf >= 7 && __cpuid_count(7, 0).edx & BF16_AND_TILE == BF16_AND_TILE && permission()
}

/// Asks the system for the tiles' registers, which only processes that asked for them have.
#[cfg(target_os = "linux")]
fn permission() -> bool {
    const ARCH_REQ_XCOMP_PERM: libc::c_ulong = 0x1023;
    const XFEATURE_XTILEDATA: libc::c_ulong = 18;
    // SAFETY: this call enlarges the state that the system keeps for threads; it changes nothing else.
    unsafe { libc::syscall(libc::SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, XFEATURE_XTILEDATA) == 0 }
}

#[cfg(not(target_os = "linux"))]
fn permission() -> bool {
    false
}

/// Neighbours of rows as pairs, followed by zeros, in tiles.
pub(super) fn pair_along_rows(
    _: Instructions,
    source: Rows,
    rows: usize,
    pairs: usize,
    packed: &mut [f32],
) {
    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    fn vectors(source: Rows, rows: usize, pairs: usize, packed: &mut [f32]) {
        for (strip, packed) in packed.chunks_exact_mut(PANEL * pairs).enumerate() {
            let first = strip * PANEL;
            for r in first..rows.min(first + PANEL) {
                along(
                    source.row(r),
                    packed.as_chunks_mut().0.iter_mut().skip(r - first).step_by(PANEL),
                );
            }
        }
    }
    // SAFETY: the processor has the instructions.
    unsafe { vectors(source, rows, pairs, packed) }
}

/// Neighbours of one row of at most `2 · packed.len()` numbers as pairs, followed by zeros.
pub(super) fn pair_along(_: Instructions, row: &[f32], packed: &mut [f32]) {
    // SAFETY: the processor has the instructions.
    unsafe { along(row, packed.as_chunks_mut().0.iter_mut()) }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn along<'p>(row: &[f32], mut packed: impl Iterator<Item = &'p mut [f32; PANEL]>) {
    let (whole, rest) = row.as_chunks::<{ 2 * PANEL }>();
    let (low, high) = rest.split_at(rest.len().min(PANEL));
    for (row, packed) in whole.iter().zip(&mut packed) {
        store(round(load(&row[PANEL..]), load(&row[..PANEL])), packed);
    }
    if !rest.is_empty()
        && let Some(packed) = packed.next()
    {
        store(round(load(high), load(low)), packed);
    }
    packed.for_each(|packed| packed.fill(0.0));
}

/// Numbers of neighbouring rows as pairs, `[pairs, PANEL]`, followed by zeros.
pub(super) fn pair_across_rows(
    _: Instructions,
    source: Rows,
    from: Place,
    packed: &mut [[f32; PANEL]],
) {
    // SAFETY: the processor has the instructions.
    unsafe { across_rows(source, from, packed) }
}

#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn across_rows(source: Rows, from: Place, packed: &mut [[f32; PANEL]]) {
    // Word 2j of the result is word j, word 2j + 1 is word 16 + j.
    let mut order = [0i16; 2 * PANEL];
    for (i, order) in order.iter_mut().enumerate() {
        *order = (i / 2 + i % 2 * PANEL) as i16;
    }
    // SAFETY: 64 bytes.
    let order = unsafe { _mm512_loadu_si512(order.as_ptr().cast()) };
    let Place { rows, pair, column } = from;
    let wide = PANEL.min(source.len() - column);
    for (p, packed) in packed.iter_mut().enumerate() {
        let r = 2 * (pair + p);
        let row = |r: usize| if r < rows { &source.row(r)[column..][..wide] } else { &[] };
        let rows = round(load(row(r + 1)), load(row(r)));
        store(_mm512_permutexvar_epi16(order, rows), packed);
    }
}

/// The first [`PANEL`] numbers of a row, zeros where it is shorter.
#[inline]
#[target_feature(enable = "avx512f")]
fn load(row: &[f32]) -> __m512 {
    if let Some(row) = row.first_chunk::<PANEL>() {
        // SAFETY: 64 bytes.
        return unsafe { _mm512_loadu_ps(row.as_ptr()) };
    }
    let mask = (1u32 << row.len().min(PANEL)) - 1;
    // SAFETY: the mask selects numbers of the row only.
    unsafe { _mm512_maskz_loadu_ps(mask as __mmask16, row.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn store(pairs: __m512i, to: &mut [f32; PANEL]) {
    // SAFETY: 64 bytes.
    unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), pairs) };
}

/// bfloat16 numbers nearest to those of `low`, then of `high`; ties to even.
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
fn round(high: __m512, low: __m512) -> __m512i {
    // SAFETY: both are 64 bytes without invalid values.
    unsafe { std::mem::transmute::<__m512bh, __m512i>(_mm512_cvtne2ps_pbh(high, low)) }
}

/// Selections of the even and of the odd lanes of two vectors.
const EVEN: i32 = 0x88;
const ODD: i32 = 0xdd;

/// Transposes a block of pairs.
pub(super) fn transpose(_: Instructions, block: &mut [[f32; PANEL]; PANEL]) {
    // SAFETY: the processor has the instructions.
    unsafe { transpose_vectors(block) }
}

#[target_feature(enable = "avx512f")]
fn transpose_vectors(block: &mut [[f32; PANEL]; PANEL]) {
    // SAFETY: 64 bytes a row.
    let rows: [__m512i; PANEL] =
        std::array::from_fn(|i| unsafe { _mm512_loadu_si512(block[i].as_ptr().cast()) });
    let mut pairs = [_mm512_setzero_si512(); PANEL];
    for i in (0..PANEL).step_by(2) {
        pairs[i] = _mm512_unpacklo_epi32(rows[i], rows[i + 1]);
        pairs[i + 1] = _mm512_unpackhi_epi32(rows[i], rows[i + 1]);
    }
    // Lane `l` of `fours[g + c]` has column `4 l + c` of the rows from `g` to `g + 3`.
    let mut fours = [_mm512_setzero_si512(); PANEL];
    for g in (0..PANEL).step_by(4) {
        fours[g] = _mm512_unpacklo_epi64(pairs[g], pairs[g + 2]);
        fours[g + 1] = _mm512_unpackhi_epi64(pairs[g], pairs[g + 2]);
        fours[g + 2] = _mm512_unpacklo_epi64(pairs[g + 1], pairs[g + 3]);
        fours[g + 3] = _mm512_unpackhi_epi64(pairs[g + 1], pairs[g + 3]);
    }
    for c in 0..4 {
        let upper_even = _mm512_shuffle_i32x4::<EVEN>(fours[c], fours[4 + c]);
        let upper_odd = _mm512_shuffle_i32x4::<ODD>(fours[c], fours[4 + c]);
        let lower_even = _mm512_shuffle_i32x4::<EVEN>(fours[8 + c], fours[12 + c]);
        let lower_odd = _mm512_shuffle_i32x4::<ODD>(fours[8 + c], fours[12 + c]);
        store(_mm512_shuffle_i32x4::<EVEN>(upper_even, lower_even), &mut block[c]);
        store(_mm512_shuffle_i32x4::<EVEN>(upper_odd, lower_odd), &mut block[4 + c]);
        store(_mm512_shuffle_i32x4::<ODD>(upper_even, lower_even), &mut block[8 + c]);
        store(_mm512_shuffle_i32x4::<ODD>(upper_odd, lower_odd), &mut block[12 + c]);
    }
}

/// Adds a bias to the rows of a block and applies a leaky ReLU.
pub(super) fn finish(
    _: Instructions,
    bias: Option<&[f32]>,
    slope: Option<f32>,
    out: &mut [f32],
    stride: usize,
    [tall, wide]: [usize; 2],
) {
    // SAFETY: the processor has the instructions.
    unsafe { finish_vectors(bias, slope.unwrap_or(1.0), out, stride, [tall, wide]) }
}

#[target_feature(enable = "avx512f")]
fn finish_vectors(
    bias: Option<&[f32]>,
    slope: f32,
    out: &mut [f32],
    stride: usize,
    [tall, wide]: [usize; 2],
) {
    let mut whole = [0.0; BLOCK];
    if let Some(bias) = bias {
        whole[..wide].copy_from_slice(bias);
    }
    let activated = |sum: f32| if sum > 0.0 { sum } else { slope * sum };
    for i in 0..tall {
        let row = &mut out[i * stride..][..wide];
        match row.as_mut_array::<BLOCK>() {
            Some(row) => row.iter_mut().zip(&whole).for_each(|(out, b)| *out = activated(*out + b)),
            None => row.iter_mut().zip(&whole).for_each(|(out, b)| *out = activated(*out + b)),
        }
    }
}

/// Products of blocks on the thread that created it.
pub(super) struct Kernel {
    by: Instructions,
    // Tiles are configured for a thread.
    _thread: std::marker::PhantomData<*const ()>,
}

/// Configuration of the tiles: all of 16 rows of 64 bytes.
#[repr(C, align(64))]
struct TileConfig([u8; 64]);

const TILES: TileConfig = {
    let mut config = [0; 64];
    config[0] = 1;
    let mut tile = 0;
    while tile < 8 {
        config[16 + 2 * tile] = 64;
        config[48 + tile] = 16;
        tile += 1;
    }
    TileConfig(config)
};

impl Kernel {
    pub(super) fn new(by: Instructions) -> Self {
        if by == Instructions::Amx {
            // SAFETY: `all` has found the tiles; the configuration has 64 bytes.
            unsafe { asm!("ldtilecfg [{}]", in(reg) TILES.0.as_ptr(), options(nostack, readonly)) };
        }
        Self { by, _thread: std::marker::PhantomData }
    }

    /// `out = left · right` or, if `add`, `out += left · right` for [`BLOCK`] rows, `stride` apart, and
    /// columns.
    pub(super) fn block(
        &self,
        left: &[f32],
        right: &[f32],
        pairs: usize,
        add: bool,
        out: &mut [f32],
        stride: usize,
    ) {
        assert!(pairs > 0 && pairs.is_multiple_of(PANEL));
        assert!(left.len() >= BLOCK * pairs && right.len() >= BLOCK * pairs);
        assert!(stride >= BLOCK && out.len() >= (BLOCK - 1) * stride + BLOCK);
        let (left, right, out) = (left.as_ptr(), right.as_ptr(), out.as_mut_ptr());
        // SAFETY: the extents were asserted; `all` has found the instructions.
        unsafe {
            match self.by {
                Instructions::Amx => block_of_tiles(left, right, pairs, add, out, stride),
                Instructions::Avx512 => block_of_vectors(left, right, pairs, add, out, stride),
            }
        }
    }
}

impl Drop for Kernel {
    fn drop(&mut self) {
        if self.by == Instructions::Amx {
            // SAFETY: the tiles hold nothing that is still needed.
            unsafe { asm!("tilerelease", options(nostack, nomem)) };
        }
    }
}

/// # Safety
/// Tiles must be configured by [`TILES`]; see [`Kernel::block`] for the extents.
unsafe fn block_of_tiles(
    left: *const f32,
    right: *const f32,
    pairs: usize,
    add: bool,
    out: *mut f32,
    stride: usize,
) {
    // SAFETY: two strips of tiles of `pairs` pairs on the left, two panels of as many rows on the right, and
    // 32 rows of 32 numbers of the output are the caller's; the tiles are configured.
    unsafe {
        asm!(
            "test {add:e}, {add:e}",
            "jnz 2f",
            "tilezero tmm0",
            "tilezero tmm1",
            "tilezero tmm2",
            "tilezero tmm3",
            "jmp 3f",
            "2:",
            "tileloadd tmm0, [{out} + {out_step}]",
            "tileloadd tmm1, [{out} + {out_step} + 64]",
            "tileloadd tmm2, [{lower_out} + {out_step}]",
            "tileloadd tmm3, [{lower_out} + {out_step} + 64]",
            "3:",
            "tileloadd tmm4, [{left} + {line}]",
            "tileloadd tmm6, [{right} + {line}]",
            "tileloadd tmm5, [{lower_left} + {line}]",
            "tileloadd tmm7, [{second_right} + {line}]",
            "tdpbf16ps tmm0, tmm4, tmm6",
            "tdpbf16ps tmm2, tmm5, tmm6",
            "tdpbf16ps tmm1, tmm4, tmm7",
            "tdpbf16ps tmm3, tmm5, tmm7",
            "add {left}, 1024",
            "add {lower_left}, 1024",
            "add {right}, 1024",
            "add {second_right}, 1024",
            "dec {steps}",
            "jnz 3b",
            "tilestored [{out} + {out_step}], tmm0",
            "tilestored [{out} + {out_step} + 64], tmm1",
            "tilestored [{lower_out} + {out_step}], tmm2",
            "tilestored [{lower_out} + {out_step} + 64], tmm3",
            add = in(reg) u32::from(add),
            out = in(reg) out,
            lower_out = in(reg) out.add(PANEL * stride),
            out_step = in(reg) stride * size_of::<f32>(),
            left = inout(reg) left => _,
            lower_left = inout(reg) left.add(PANEL * pairs) => _,
            right = inout(reg) right => _,
            second_right = inout(reg) right.add(PANEL * pairs) => _,
            line = in(reg) PANEL * size_of::<f32>(),
            steps = inout(reg) pairs / PANEL => _,
            out("tmm0") _,
            out("tmm1") _,
            out("tmm2") _,
            out("tmm3") _,
            out("tmm4") _,
            out("tmm5") _,
            out("tmm6") _,
            out("tmm7") _,
            options(nostack),
        );
    }
}

/// Rows of a block whose sums are kept in registers.
const TALL: usize = 8;

/// # Safety
/// See [`Kernel::block`] for the extents.
#[allow(clippy::needless_range_loop, reason = "indices of registers")]
#[target_feature(enable = "avx512f,avx512bf16")]
unsafe fn block_of_vectors(
    left: *const f32,
    right: *const f32,
    pairs: usize,
    add: bool,
    out: *mut f32,
    stride: usize,
) {
    for first in (0..BLOCK).step_by(TALL) {
        // SAFETY: two strips of tiles of `pairs` pairs on the left, two panels of as many rows on the right,
        // and 32 rows of 32 numbers of the output are the caller's.
        unsafe {
            let left =
                left.add(first / PANEL * PANEL * pairs + first % PANEL * PANEL).cast::<i32>();
            let at = |i: usize, j: usize| out.add((first + i) * stride + j * PANEL);
            let mut sums = [[_mm512_setzero_ps(); 2]; TALL];
            if add {
                for i in 0..TALL {
                    for j in 0..2 {
                        sums[i][j] = _mm512_loadu_ps(at(i, j));
                    }
                }
            }
            for p in 0..pairs {
                let panel = |j: usize| {
                    let from = right.add((j * pairs + p) * PANEL);
                    std::mem::transmute::<__m512i, __m512bh>(_mm512_loadu_si512(from.cast()))
                };
                let right = [panel(0), panel(1)];
                for i in 0..TALL {
                    let at = p / PANEL * PANEL * PANEL + p % PANEL;
                    let pair = _mm512_set1_epi32(*left.add(at + i * PANEL));
                    let pair = std::mem::transmute::<__m512i, __m512bh>(pair);
                    for j in 0..2 {
                        sums[i][j] = _mm512_dpbf16_ps(sums[i][j], pair, right[j]);
                    }
                }
            }
            for i in 0..TALL {
                for j in 0..2 {
                    _mm512_storeu_ps(at(i, j), sums[i][j]);
                }
            }
        }
    }
}
