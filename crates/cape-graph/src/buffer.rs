#![allow(unsafe_code)] // Burn takes foreign memory through an unsafe constructor.

//! Pool of the memory of tensors on the CPU: an allocator would return buffers of this size to the
//! system and fault in every page again.

use std::{
    collections::BTreeMap,
    ops::{Deref, DerefMut},
    sync::{Mutex, MutexGuard, PoisonError},
};

/// Number of floats in a cache line.
const LINE: usize = 16;
/// Length, in floats, from which buffers are pooled.
const SMALLEST: usize = 1 << 14;
/// Limit of the pool in floats: 4 GiB.
const LIMIT: usize = 1 << 30;

static IDLE: Mutex<Idle> = Mutex::new(Idle { buffers: BTreeMap::new(), total: 0 });

/// Buffers that are not in use.
struct Idle {
    /// Buffers by length.
    buffers: BTreeMap<usize, Vec<Vec<f32>>>,
    /// Number of floats in all of them.
    total: usize,
}

impl Idle {
    /// The shortest buffer of at least `len` floats, but at most a quarter longer.
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
        if self.total + buffer.len() <= LIMIT {
            self.total += buffer.len();
            self.buffers.entry(buffer.len()).or_default().push(buffer);
        }
    }

    /// Frees all buffers; returns their size in floats.
    fn release(&mut self) -> usize {
        self.buffers.clear();
        std::mem::take(&mut self.total)
    }
}

fn idle() -> MutexGuard<'static, Idle> {
    IDLE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Frees the pool; returns its size in bytes.
pub(crate) fn release() -> usize {
    idle().release() * size_of::<f32>()
}

/// Floats aligned to a cache line, whose memory returns to the pool.
#[derive(Debug, Default)]
pub(crate) struct Buffer {
    memory: Vec<f32>,
    start: usize,
    len: usize,
}

impl Buffer {
    /// Buffer of `len` unspecified values.
    pub(crate) fn take(len: usize) -> Self {
        let size = len + LINE;
        let memory = if size < SMALLEST { None } else { idle().take(size) };
        let memory = memory.unwrap_or_else(|| allocate(size));
        let start = memory.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE);
        Self { memory, start, len }
    }

    /// Buffer of `len` zeros.
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

/// Size, in bytes, from which pages of 2 MB are requested.
#[cfg(target_os = "linux")]
const LARGE: usize = 4 << 20;

/// Advises the system to use pages of 2 MB: rows of a layer are pages apart, and the processor caches
/// the addresses of a few dozen pages only. It affects speed alone.
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
            idle().put(memory);
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
            // SAFETY: the same memory as possibly uninitialised bytes; the caller writes initialised
            // bytes only, and every bit pattern is a float.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_reused_up_to_a_quarter_longer_and_released() {
        let mut idle = Idle { buffers: BTreeMap::new(), total: 0 };
        idle.put(vec![0.0; 1250]);
        assert!(idle.take(999).is_none() && idle.take(1251).is_none());
        assert_eq!(idle.take(1000).unwrap().len(), 1250);
        assert_eq!((idle.total, idle.buffers.len()), (0, 0));
        idle.put(vec![0.0; 30]);
        idle.put(vec![0.0; 12]);
        assert_eq!(idle.release(), 42);
        assert!(idle.take(30).is_none());
    }

    #[test]
    fn the_pool_keeps_no_more_than_its_limit() {
        let mut idle = Idle { buffers: BTreeMap::new(), total: LIMIT - 10 };
        idle.put(vec![0.0; 11]);
        assert!(idle.take(11).is_none());
        idle.put(vec![0.0; 10]);
        assert_eq!(idle.total, LIMIT);
        assert!(idle.take(10).is_some());
    }
}
