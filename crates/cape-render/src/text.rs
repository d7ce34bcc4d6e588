use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use crate::Image;

/// Font size by line height.
///
/// ```
/// use cape_render::{Image, TextSize};
///
/// let size = TextSize::Large;
/// let mut label = Image::new(size.width("CAPE"), size.height(), [255; 4])?;
/// label.text("CAPE", 0, 0, size, [0; 3]);
/// assert_eq!(label.height(), 24);
/// assert!(label.pixels().iter().any(|&[red, ..]| red < 128));
/// # Ok::<(), cape_render::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TextSize {
    /// 16 pixels.
    #[default]
    Small,
    /// 24 pixels.
    Large,
}

impl TextSize {
    const fn raster(self) -> RasterHeight {
        match self {
            Self::Small => RasterHeight::Size16,
            Self::Large => RasterHeight::Size24,
        }
    }

    /// Height of a line, pixels.
    pub const fn height(self) -> u32 {
        match self {
            Self::Small => 16,
            Self::Large => 24,
        }
    }

    /// Width of `text`, pixels.
    pub fn width(self, text: &str) -> u32 {
        let letter = get_raster_width(FontWeight::Regular, self.raster());
        (text.chars().count() * letter) as u32
    }
}

impl Image {
    /// Draws a line of text with its top left corner at (`x`, `y`). Characters missing in the font
    /// appear as question marks.
    pub fn text(&mut self, text: &str, x: i64, y: i64, size: TextSize, colour: [u8; 3]) {
        draw(text, size, |column, row, opacity| {
            self.blend(x + column, y + row, colour, opacity);
        });
    }

    /// Draws a line of text upwards, starting at (`x`, `y`).
    pub fn text_upwards(&mut self, text: &str, x: i64, y: i64, size: TextSize, colour: [u8; 3]) {
        draw(text, size, |column, row, opacity| {
            self.blend(x + row, y - column, colour, opacity);
        });
    }
}

/// Calls `dot` with column, row and opacity of each pixel of the text.
fn draw(text: &str, size: TextSize, mut dot: impl FnMut(i64, i64, f32)) {
    let letter = get_raster_width(FontWeight::Regular, size.raster());
    for (position, character) in text.chars().enumerate() {
        let raster = |c| get_raster(c, FontWeight::Regular, size.raster());
        let Some(glyph) = raster(character).or_else(|| raster('?')) else { continue };
        for (row, line) in glyph.rows().enumerate() {
            for (column, &ink) in line.iter().enumerate() {
                if ink > 0 {
                    let x = (position * letter + column) as i64;
                    dot(x, row as i64, f32::from(ink) / 255.0);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_in_its_box_and_has_ink_in_every_letter() {
        let size = TextSize::Small;
        let (width, height) = (size.width("Wé8"), size.height());
        let mut image = Image::new(width + 20, height + 20, [255; 4]).unwrap();
        image.text("Wé8", 10, 10, size, [0; 3]);
        let letter = width / 3;
        for i in 0..3 {
            let ink = (0..image.height()).any(|y| {
                (10 + i * letter..10 + (i + 1) * letter).any(|x| image.get(x, y).unwrap()[0] < 128)
            });
            assert!(ink, "letter {i}");
        }
        for y in 0..image.height() {
            for x in 0..image.width() {
                let inside = (10..10 + width).contains(&x) && (10..10 + height).contains(&y);
                assert!(inside || image.get(x, y) == Some([255; 4]));
            }
        }
    }
}
