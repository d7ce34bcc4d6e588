use std::{io::Write, path::Path};

use cape_core::write_atomically;

use crate::{Error, ImageFile, Result};

/// Largest width and height of an image, pixels.
pub const MAX_SIDE: u32 = 16_384;

/// 8-bit sRGB image with straight alpha, row 0 at the top.
///
/// ```
/// use cape_render::Image;
///
/// let mut image = Image::new(4, 3, [255; 4])?;
/// image.blend(1, 2, [200, 0, 0], 1.0);
/// assert_eq!(image.get(1, 2), Some([200, 0, 0, 255]));
/// assert_eq!(image.get(4, 0), None);
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("dot.png");
/// image.save(&path)?;
/// assert_eq!(Image::load(&path)?, image);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    width: u32,
    height: u32,
    pixels: Vec<[u8; 4]>,
}

impl Image {
    /// Creates an image of one colour.
    ///
    /// # Errors
    /// If a side is not from 1 to [`MAX_SIDE`].
    pub fn new(width: u32, height: u32, colour: [u8; 4]) -> Result<Self> {
        if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE {
            return Err(Error::Argument(format!(
                "image of {width}×{height} pixels: each side must be from 1 to {MAX_SIDE}"
            )));
        }
        Ok(Self { width, height, pixels: vec![colour; width as usize * height as usize] })
    }

    /// Width, pixels.
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// RGBA pixels, row by row, `[height · width]`.
    pub fn pixels(&self) -> &[[u8; 4]] {
        &self.pixels
    }

    /// Mutable RGBA pixels, row by row, `[height · width]`.
    pub fn pixels_mut(&mut self) -> &mut [[u8; 4]] {
        &mut self.pixels
    }

    /// RGBA pixel at column `x` and row `y`; `None` outside the image.
    pub fn get(&self, x: u32, y: u32) -> Option<[u8; 4]> {
        (x < self.width && y < self.height)
            .then(|| self.pixels[y as usize * self.width as usize + x as usize])
    }

    /// Blends `colour` over the pixel at (`x`, `y`) with `opacity`, 0 to 1; ignored outside the image.
    pub fn blend(&mut self, x: i64, y: i64, colour: [u8; 3], opacity: f32) {
        let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y)) else { return };
        if x >= self.width || y >= self.height {
            return;
        }
        let pixel = &mut self.pixels[y as usize * self.width as usize + x as usize];
        *pixel = over(*pixel, colour, opacity.clamp(0.0, 1.0));
    }

    /// Blends `other` over this image with its top left corner at (`x`, `y`).
    pub fn draw(&mut self, other: &Self, x: i64, y: i64) {
        for (row, line) in other.pixels.chunks_exact(other.width as usize).enumerate() {
            for (column, &[r, g, b, a]) in line.iter().enumerate() {
                let opacity = f32::from(a) / 255.0;
                self.blend(x + column as i64, y + row as i64, [r, g, b], opacity);
            }
        }
    }

    /// The image scaled down so that its longer side is at most `side` pixels, by the mean of the
    /// pixels that fall together.
    ///
    /// # Errors
    /// If `side` is 0.
    pub fn reduced(&self, side: u32) -> Result<Self> {
        let longer = self.width.max(self.height);
        if side == 0 {
            return Err(Error::Argument("image: a side of 0 pixels, expected 1 or more".into()));
        }
        if longer <= side {
            return Ok(self.clone());
        }
        let scaled =
            |length: u32| (u64::from(length) * u64::from(side)).div_ceil(longer.into()) as u32;
        let mut reduced = Self::new(scaled(self.width), scaled(self.height), [0; 4])?;
        let span = |at: u32, count: u32, of: u32| {
            let bound = |at: u32| (u64::from(at) * u64::from(of) / u64::from(count)) as usize;
            bound(at)..bound(at + 1)
        };
        let (width, height) = (reduced.width, reduced.height);
        for (at, to) in reduced.pixels.iter_mut().enumerate() {
            let (x, y) = (at as u32 % width, at as u32 / width);
            let (columns, rows) = (span(x, width, self.width), span(y, height, self.height));
            let count = (columns.len() * rows.len()) as u32;
            let mut sums = [0u32; 4];
            for row in rows {
                for pixel in &self.pixels[row * self.width as usize..][columns.clone()] {
                    sums.iter_mut().zip(pixel).for_each(|(sum, &value)| *sum += u32::from(value));
                }
            }
            *to = sums.map(|sum| ((sum + count / 2) / count) as u8);
        }
        Ok(reduced)
    }

    /// Writes a PNG file, atomically.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        Ok(write_atomically(path, |file| self.encode(file))?)
    }

    /// Writes the image as PNG to `sink`.
    pub fn encode(&self, mut sink: impl Write) -> std::io::Result<()> {
        let mut encoder = png::Encoder::new(&mut sink, self.width, self.height);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()?;
        sink.flush()
    }

    /// Reads a PNG or JPEG file, upright, converted to 8 bits and RGBA; see [`ImageFile`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        ImageFile::read(path)?.to_image()
    }
}

fn over([r, g, b, a]: [u8; 4], top: [u8; 3], opacity: f32) -> [u8; 4] {
    let below = f32::from(a) / 255.0 * (1.0 - opacity);
    let alpha = opacity + below;
    if alpha <= 0.0 {
        return [0; 4];
    }
    let mix = |low: u8, high: u8| {
        ((f32::from(low) * below + f32::from(high) * opacity) / alpha).round() as u8
    };
    [mix(r, top[0]), mix(g, top[1]), mix(b, top[2]), (alpha * 255.0).round() as u8]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_round_trip_keeps_every_pixel() {
        let mut image = Image::new(7, 5, [0; 4]).unwrap();
        for (i, pixel) in image.pixels_mut().iter_mut().enumerate() {
            *pixel = [i as u8 * 7, 255 - i as u8, i as u8 ^ 0x5a, if i % 3 == 0 { 0 } else { 200 }];
        }
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("picture.png");
        image.save(&path).unwrap();
        assert_eq!(Image::load(&path).unwrap(), image);
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_truncated_png_is_an_error_naming_the_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("cut.png");
        let mut bytes = Vec::new();
        Image::new(64, 64, [9, 8, 7, 255]).unwrap().encode(&mut bytes).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(Image::load(&path).unwrap_err().to_string().contains("cut.png"));
    }

    #[test]
    fn reduced_images_have_the_means_of_their_pixels() {
        let mut image = Image::new(6, 4, [10, 20, 30, 255]).unwrap();
        image.pixels_mut()[7] = [50, 20, 30, 255];
        let small = image.reduced(3).unwrap();
        assert_eq!((small.width(), small.height()), (3, 2));
        assert_eq!(small.pixels()[0], [20, 20, 30, 255]);
        assert!(small.pixels()[1..].iter().all(|pixel| *pixel == [10, 20, 30, 255]));
        assert_eq!(image.reduced(6).unwrap(), image);
        let uneven = image.reduced(5).unwrap();
        assert_eq!((uneven.width(), uneven.height()), (5, 4));
        assert!(image.reduced(0).is_err());
    }

    #[test]
    fn sides_are_checked() {
        assert!(Image::new(0, 4, [0; 4]).is_err());
        assert!(Image::new(4, MAX_SIDE + 1, [0; 4]).is_err());
    }

    #[test]
    fn blending_is_linear_in_opacity_and_keeps_opaque_pixels_opaque() {
        let mut image = Image::new(1, 1, [100, 0, 0, 255]).unwrap();
        image.blend(0, 0, [200, 0, 0], 0.5);
        image.blend(-1, 0, [255; 3], 1.0);
        assert_eq!(image.get(0, 0), Some([150, 0, 0, 255]));
        assert_eq!(image.get(1, 0), None);
    }
}
