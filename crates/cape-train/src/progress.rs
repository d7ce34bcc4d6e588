/// Called by long operations with the work done so far and the whole of it, in the operation's own
/// units (frames, batches); the last call has both equal. What is shown, if anything, is up to the
/// caller.
pub type Progress<'a> = dyn FnMut(usize, usize) + 'a;

/// The [`Progress`] that shows nothing.
pub fn silent(_done: usize, _total: usize) {}
