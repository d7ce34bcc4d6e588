use rand::{SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use serde::{Deserialize, Serialize};

/// Stream of random permutations, independent of the other streams of a seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShuffleStream {
    /// Batches of the generator.
    Generator,
    /// Real batches of the discriminator.
    Discriminator,
}

/// Position in a shuffle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShufflePosition {
    /// Number of complete passes over the frames.
    pub epoch: u64,
    /// Number of frames drawn in the current pass.
    pub drawn: usize,
}

/// Endless stream of frames: consecutive random permutations of all frames.
///
/// Every frame is drawn once before any is drawn twice. The permutation depends on seed, stream and
/// pass alone, so that a [`ShufflePosition`] is enough to resume.
///
/// ```
/// use cape_data::{ShufflePosition, Shuffle, ShuffleStream};
///
/// let mut shuffle = Shuffle::new(1, ShuffleStream::Generator, 5, ShufflePosition::default());
/// let mut drawn = shuffle.draw(3);
/// let position = shuffle.position();
/// assert_eq!(position, ShufflePosition { epoch: 0, drawn: 3 });
/// drawn.extend(shuffle.draw(2));
/// // The same frames follow from that position; all frames are drawn in a pass.
/// assert_eq!(Shuffle::new(1, ShuffleStream::Generator, 5, position).draw(2), drawn[3..]);
/// drawn.sort_unstable();
/// assert_eq!(drawn, [0, 1, 2, 3, 4]);
/// ```
#[derive(Debug, Clone)]
pub struct Shuffle {
    seed: u64,
    stream: ShuffleStream,
    position: ShufflePosition,
    order: Vec<usize>,
}

impl Shuffle {
    /// Creates the shuffle of `frames` frames (at least 1) at a position.
    pub fn new(seed: u64, stream: ShuffleStream, frames: usize, position: ShufflePosition) -> Self {
        let position = ShufflePosition { drawn: position.drawn.min(frames), ..position };
        let mut shuffle = Self { seed, stream, position, order: (0..frames.max(1)).collect() };
        shuffle.permute();
        shuffle
    }

    /// Draws the next `count` frames, from the next pass if the current one ends.
    pub fn draw(&mut self, count: usize) -> Vec<usize> {
        let mut frames = Vec::with_capacity(count);
        while frames.len() < count {
            if self.position.drawn >= self.order.len() {
                self.position = ShufflePosition { epoch: self.position.epoch + 1, drawn: 0 };
                self.permute();
            }
            frames.push(self.order[self.position.drawn]);
            self.position.drawn += 1;
        }
        frames
    }

    /// Position of the next draw.
    pub fn position(&self) -> ShufflePosition {
        self.position
    }

    fn permute(&mut self) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(2 * self.position.epoch + self.stream as u64);
        for (frame, slot) in self.order.iter_mut().enumerate() {
            *slot = frame;
        }
        self.order.shuffle(&mut rng);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shuffle(seed: u64, stream: ShuffleStream, frames: usize) -> Shuffle {
        Shuffle::new(seed, stream, frames, ShufflePosition::default())
    }

    #[test]
    fn every_frame_once_before_any_twice() {
        let mut shuffle = shuffle(3, ShuffleStream::Generator, 10);
        let drawn: Vec<usize> = (0..15).flat_map(|_| shuffle.draw(4)).collect();
        let passes: Vec<&[usize]> = drawn.chunks(10).collect();
        for pass in &passes {
            let mut sorted = pass.to_vec();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..10).collect::<Vec<_>>());
        }
        assert_ne!(passes[0], passes[1]);
    }

    #[test]
    fn streams_and_seeds_differ_and_repeat() {
        let draw = |seed, stream| shuffle(seed, stream, 50).draw(50);
        let first = draw(1, ShuffleStream::Generator);
        assert_eq!(first, draw(1, ShuffleStream::Generator));
        assert_ne!(first, draw(1, ShuffleStream::Discriminator));
        assert_ne!(first, draw(2, ShuffleStream::Generator));
    }

    /// A run that is resumed with a later version goes on with the same frames.
    #[test]
    fn a_seed_stands_for_the_same_order_for_good() {
        let mut generator = shuffle(7, ShuffleStream::Generator, 10);
        assert_eq!(generator.draw(10), [0, 7, 5, 2, 9, 1, 6, 8, 3, 4]);
        assert_eq!(generator.draw(10), [8, 2, 6, 1, 7, 9, 0, 3, 5, 4]);
        let mut discriminator = shuffle(7, ShuffleStream::Discriminator, 10);
        assert_eq!(discriminator.draw(10), [9, 5, 7, 1, 4, 8, 3, 2, 6, 0]);
    }

    #[test]
    fn any_position_resumes() {
        for warm in 0..12 {
            let mut whole = shuffle(9, ShuffleStream::Discriminator, 7);
            whole.draw(warm * 3);
            let mut resumed = Shuffle::new(9, ShuffleStream::Discriminator, 7, whole.position());
            assert_eq!(whole.draw(20), resumed.draw(20));
        }
    }

    /// Saved positions are valid only if all versions draw the same order.
    #[test]
    fn the_order_is_pinned() {
        let draw = |stream| shuffle(1, stream, 8).draw(8);
        assert_eq!(draw(ShuffleStream::Generator), [3, 4, 5, 2, 7, 1, 6, 0]);
        assert_eq!(draw(ShuffleStream::Discriminator), [6, 5, 2, 3, 0, 4, 7, 1]);
    }

    #[test]
    fn one_frame_fills_a_batch() {
        let mut shuffle = shuffle(0, ShuffleStream::Generator, 1);
        assert_eq!(shuffle.draw(3), [0, 0, 0]);
        assert_eq!(shuffle.position(), ShufflePosition { epoch: 2, drawn: 1 });
    }
}
