/// Callback `(done, total)` of long operations, in the operation's own units (frames, batches); the
/// last call has `done == total`.
///
/// ```
/// use cape_core::{ProgressFn, silent};
///
/// fn count_to_three(progress: &mut ProgressFn) {
///     for done in 0..=3 {
///         progress(done, 3);
///     }
/// }
///
/// let mut shown = Vec::new();
/// count_to_three(&mut |done, total| shown.push(format!("{done}/{total}")));
/// assert_eq!(shown, ["0/3", "1/3", "2/3", "3/3"]);
/// count_to_three(&mut silent);
/// ```
pub type ProgressFn<'a> = dyn FnMut(usize, usize) + 'a;

/// A [`ProgressFn`] that does nothing.
pub fn silent(_done: usize, _total: usize) {}
