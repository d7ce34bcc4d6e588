//! Animated PNG files.

use std::{io::Write, path::Path};

use cape_core::write_atomically;

use crate::{Error, Image, Result};

/// Writes images of equal size as an endlessly repeated animated PNG, atomically.
///
/// # Errors
/// If there is no image, sizes differ, or the file cannot be written.
pub fn save_animation(
    path: impl AsRef<Path>,
    frames: &[Image],
    frames_per_second: u16,
) -> Result<()> {
    let Some(first) = frames.first() else {
        return Err(Error::Argument("animation without images: expected at least 1".into()));
    };
    let (width, height) = (first.width(), first.height());
    if let Some(other) = frames.iter().find(|f| (f.width(), f.height()) != (width, height)) {
        return Err(Error::Argument(format!(
            "animation of images of {width}×{height} and {}×{} pixels: expected equal sizes",
            other.width(),
            other.height()
        )));
    }
    Ok(write_atomically(path, |file| {
        let mut encoder = png::Encoder::new(&mut *file, width, height);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder.set_animated(frames.len() as u32, 0)?;
        encoder.set_frame_delay(1, frames_per_second.max(1))?;
        let mut writer = encoder.write_header()?;
        for frame in frames {
            writer.write_image_data(frame.pixels().as_flattened())?;
        }
        writer.finish()?;
        file.flush()
    })?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_images_are_in_the_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.png");
        let frames: Vec<Image> =
            (0..3).map(|i| Image::new(4, 2, [10 * i, 20, 30, 255]).unwrap()).collect();
        save_animation(&path, &frames, 12).unwrap();
        let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let control = reader.info().animation_control().unwrap();
        assert_eq!((control.num_frames, control.num_plays), (3, 0));
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        for frame in &frames {
            reader.next_frame(&mut bytes).unwrap();
            assert_eq!(bytes, frame.pixels().as_flattened());
            let shown = reader.info().frame_control().unwrap();
            assert_eq!((shown.delay_num, shown.delay_den), (1, 12));
        }
    }

    #[test]
    fn images_of_different_sizes_are_rejected() {
        let frames = [(2, 2), (3, 2)].map(|(w, h)| Image::new(w, h, [0; 4]).unwrap());
        assert!(save_animation("x.png", &frames, 10).is_err());
        assert!(save_animation("x.png", &[], 10).is_err());
    }
}
