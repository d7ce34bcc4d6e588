use std::ops::Range;

/// The part of every batch that one of several processes works on.
///
/// ```
/// use cape_data::BatchPart;
///
/// // A batch of five frames by four processes.
/// let parts = [0, 1, 2, 3].map(|index| BatchPart { index, count: 4 }.range(5));
/// assert_eq!(parts, [0..1, 1..2, 2..3, 3..5]);
/// assert_eq!(BatchPart::WHOLE.range(5), 0..5);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BatchPart {
    /// Number of the part, from 0.
    pub index: usize,
    /// Number of parts.
    pub count: usize,
}

impl BatchPart {
    /// The whole batch.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Rows of the part in a batch of `rows` rows; empty in some parts if there are fewer rows than parts.
    pub fn range(self, rows: usize) -> Range<usize> {
        let count = self.count.max(1);
        let bound = |index: usize| rows * index.min(count) / count;
        bound(self.index)..bound(self.index + 1)
    }

    /// Rows that a [`Loader`](crate::Loader) reads: those of the part, or the first of the batch if it has
    /// none, which does not count then.
    pub fn read_range(self, rows: usize) -> Range<usize> {
        let range = self.range(rows);
        if range.is_empty() { 0..1.min(rows) } else { range }
    }
}

impl Default for BatchPart {
    fn default() -> Self {
        Self::WHOLE
    }
}
