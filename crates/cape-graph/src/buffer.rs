#![allow(unsafe_code)] // Burn takes foreign memory through an unsafe constructor.

//! Memory of tensors, reused from one operation to the next: an allocator would return buffers of
//! this size to the system and fetch them page by page again.

use std::{
    collections::BTreeMap,
    ops::{Deref, DerefMut},
    sync::{Mutex, PoisonError},
};

/// Floats in a cache line.
const LINE: usize = 16;
/// Shorter buffers are left to the allocator.
const SMALLEST: usize = 1 << 14;
/// Floats kept for later at most.
const KEPT: usize = 1 << 30;

static IDLE: Mutex<Idle> = Mutex::new(Idle { buffers: BTreeMap::new(), total: 0 });

struct Idle {
    /// By length.
    buffers: BTreeMap<usize, Vec<Vec<f32>>>,
    total: usize,
}

impl Idle {
    /// The shortest buffer of at least that length, unless most of it would be wasted.
    fn take(&mut self, len: usize) -> Option<Vec<f32>> {
        let (&size, buffers) = self.buffers.range_mut(len..=len + len / 4).next()?;
        let buffer = buffers.pop();
        if buffers.is_empty() {
            self.buffers.remove(&size);
        }
        self.total -= size;
        buffer
    }

    fn put(&mut self, buffer: Vec<f32>) {
        if self.total + buffer.len() <= KEPT {
            self.total += buffer.len();
            self.buffers.entry(buffer.len()).or_default().push(buffer);
        }
    }
}

/// Floats that start at a cache line; their memory is kept for the next buffer of that size.
#[derive(Debug, Default)]
pub(crate) struct Buffer {
    memory: Vec<f32>,
    start: usize,
    len: usize,
}

impl Buffer {
    /// Of `len` numbers, unspecified ones.
    pub(crate) fn take(len: usize) -> Self {
        let size = len + LINE;
        let idle = || IDLE.lock().unwrap_or_else(PoisonError::into_inner).take(size);
        let memory = if size < SMALLEST { None } else { idle() };
        let memory = memory.unwrap_or_else(|| allocate(size));
        let start = memory.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE);
        Self { memory, start, len }
    }

    /// Of `len` zeros.
    pub(crate) fn zeros(len: usize) -> Self {
        let mut buffer = Self::take(len);
        buffer.fill(0.0);
        buffer
    }
}

fn allocate(size: usize) -> Vec<f32> {
    let memory = vec![0.0; size];
    #[cfg(target_os = "linux")]
    if size_of_val::<[f32]>(&memory) >= LARGE {
        prefer_large_pages(&memory);
    }
    memory
}

/// Bytes from which pages of 2 MB are asked for.
#[cfg(target_os = "linux")]
const LARGE: usize = 4 << 20;

/// Asks for pages of 2 MB: rows of a layer are pages apart, and the processor remembers the
/// addresses of a few dozen pages only. It is advice; without it nothing but speed changes.
#[cfg(target_os = "linux")]
fn prefer_large_pages(memory: &[f32]) {
    const PAGE: usize = 4096;
    let skipped = memory.as_ptr().cast::<u8>().align_offset(PAGE);
    let len = size_of_val(memory).saturating_sub(skipped) / PAGE * PAGE;
    // SAFETY: whole pages inside a live allocation; the advice does not change their contents.
    unsafe {
        let start = memory.as_ptr().cast::<u8>().add(skipped).cast_mut();
        libc::madvise(start.cast(), len, libc::MADV_HUGEPAGE);
    }
}

impl Deref for Buffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.memory[self.start..][..self.len]
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.memory[self.start..][..self.len]
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        if self.memory.len() >= SMALLEST {
            let memory = std::mem::take(&mut self.memory);
            IDLE.lock().unwrap_or_else(PoisonError::into_inner).put(memory);
        }
    }
}

#[cfg(feature = "flex")]
mod bytes {
    use std::mem::MaybeUninit;

    use burn_std::{AccessError, AccessPolicy, AllocationController, AllocationProperty, Bytes};

    use super::Buffer;

    impl AllocationController for Buffer {
        fn alloc_align(&self) -> usize {
            super::LINE * size_of::<f32>()
        }

        fn property(&self) -> AllocationProperty {
            AllocationProperty::Other
        }

        unsafe fn memory_mut(
            &mut self,
            _: AccessPolicy,
        ) -> Result<&mut [MaybeUninit<u8>], AccessError> {
            let numbers: &mut [f32] = self;
            let (data, len) = (numbers.as_mut_ptr(), size_of_val(numbers));
            // SAFETY: the same memory, as bytes that may be anything; the caller writes no
            // uninitialised ones, and every bit pattern is a float.
            Ok(unsafe { std::slice::from_raw_parts_mut(data.cast(), len) })
        }

        fn memory(&self, _: AccessPolicy) -> Result<&[MaybeUninit<u8>], AccessError> {
            let numbers: &[f32] = self;
            let (data, len) = (numbers.as_ptr(), size_of_val(numbers));
            // SAFETY: the same memory, as bytes.
            Ok(unsafe { std::slice::from_raw_parts(data.cast(), len) })
        }
    }

    impl From<Buffer> for Bytes {
        fn from(buffer: Buffer) -> Self {
            let len = size_of_val::<[f32]>(&buffer);
            // SAFETY: all of the buffer is initialised.
            unsafe { Self::from_controller(Box::new(buffer), len) }
        }
    }
}
