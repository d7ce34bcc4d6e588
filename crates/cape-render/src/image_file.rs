//! Image files of cameras and other programs: PNG of any colour type and depth, and JPEG.

use std::{
    fs::File,
    io::{BufReader, Cursor, Read},
    path::Path,
};

use zune_jpeg::{
    JpegDecoder,
    zune_core::{colorspace::ColorSpace, options::DecoderOptions},
};

use crate::{Error, Image, MAX_SIDE, Result};

/// Largest expansion ratio of Deflate and of JPEG's entropy coding, of the bytes of an image.
const MAX_RATIO: u64 = 2048;
/// Formats that are named but not read, by their first bytes.
const OTHERS: [(&[u8], usize, &str); 8] = [
    (b"WEBP", 8, "WebP"),
    (b"GIF8", 0, "GIF"),
    (b"BM", 0, "BMP"),
    (b"II*\0", 0, "TIFF"),
    (b"MM\0*", 0, "TIFF"),
    (b"ftypheic", 4, "HEIC"),
    (b"ftypmif1", 4, "HEIC"),
    (b"ftypavif", 4, "AVIF"),
];

/// Format of an image file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageFormat {
    /// Portable Network Graphics, exact.
    Png,
    /// JPEG, with compression noise.
    Jpeg,
}

/// Samples of an image file as it stores them, upright: turned by its EXIF orientation.
///
/// ```
/// use cape_render::{Image, ImageFile};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("dot.png");
/// Image::new(4, 3, [200, 0, 0, 255])?.save(&path)?;
/// let file = ImageFile::read(&path)?;
/// assert_eq!((file.width(), file.height(), file.channels(), file.largest()), (4, 3, 4, 255));
/// assert_eq!(file.samples()[..4], [200, 0, 0, 255]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ImageFile {
    format: ImageFormat,
    width: u32,
    height: u32,
    channels: usize,
    largest: u16,
    samples: Vec<u16>,
    palette: Option<Vec<[u8; 4]>>,
    transparent: Option<Vec<u16>>,
    turned: bool,
}

impl ImageFile {
    /// Reads a PNG or JPEG file, told apart by the content.
    ///
    /// # Errors
    /// If the file is neither, is cut off, or has a side above [`MAX_SIDE`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file = File::open(path).map_err(|source| cape_core::Error::io(path, source))?;
        let mut reader = BufReader::new(file);
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).map_err(|source| cape_core::Error::io(path, source))?;
        let read = if bytes.starts_with(b"\x89PNG") {
            png(&bytes)
        } else if bytes.starts_with(&[0xff, 0xd8]) {
            jpeg(&bytes)
        } else {
            let known = OTHERS.iter().find(|(magic, at, _)| {
                bytes.get(*at..).is_some_and(|rest| rest.starts_with(magic))
            });
            Err(match (cape_core::unexpected_file(path), known) {
                (_, Some((_, _, name))) => {
                    format!("{name} image, expected PNG or JPEG: convert it")
                }
                (Some(found), _) => found.to_owned(),
                (None, None) => "expected a PNG or JPEG image".to_owned(),
            })
        };
        read.map_err(|message| Error::from(cape_core::Error::format(path, message)))
    }

    /// Format of the file.
    pub const fn format(&self) -> ImageFormat {
        self.format
    }

    /// Width of the upright image, pixels.
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Height of the upright image, pixels.
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// Samples of a pixel: 1 (grey or palette index), 2 (grey, alpha), 3 (RGB) or 4 (RGBA).
    pub const fn channels(&self) -> usize {
        self.channels
    }

    /// Largest value that a sample can have: 1, 3, 15, 255 or 65535.
    pub const fn largest(&self) -> u16 {
        self.largest
    }

    /// Samples, row by row, `[height · width · channels]`.
    pub fn samples(&self) -> &[u16] {
        &self.samples
    }

    /// RGBA colours of the palette; `None` if samples are not indices.
    pub fn palette(&self) -> Option<&[[u8; 4]]> {
        self.palette.as_deref()
    }

    /// True if the pixels were stored in another orientation, as EXIF tells.
    pub const fn turned(&self) -> bool {
        self.turned
    }

    /// Opacity of each pixel, 0 to 255, `[height · width]`; `None` if the file has none.
    pub fn opacity(&self) -> Option<Vec<u8>> {
        let pixels = || self.samples.chunks_exact(self.channels);
        if let Some(palette) = &self.palette {
            let alpha = |index: &u16| palette.get(usize::from(*index)).map_or(255, |c| c[3]);
            let any = palette.iter().any(|colour| colour[3] < 255);
            return any.then(|| self.samples.iter().map(alpha).collect());
        }
        if let Some(colour) = &self.transparent {
            return Some(pixels().map(|p| if p == colour { 0 } else { 255 }).collect());
        }
        let with_alpha = matches!(self.channels, 2 | 4);
        with_alpha.then(|| pixels().map(|p| self.to_8_bits(p[self.channels - 1])).collect())
    }

    /// RGB colour of each pixel, `[height · width]`.
    pub fn colours(&self) -> Vec<[u8; 3]> {
        if let Some(palette) = &self.palette {
            let colour = |index: &u16| {
                palette.get(usize::from(*index)).map_or([0; 3], |&[r, g, b, _]| [r, g, b])
            };
            return self.samples.iter().map(colour).collect();
        }
        let colour = |pixel: &[u16]| match *pixel {
            [r, g, b, ..] => [r, g, b].map(|sample| self.to_8_bits(sample)),
            [grey, ..] => [self.to_8_bits(grey); 3],
            [] => [0; 3],
        };
        self.samples.chunks_exact(self.channels).map(colour).collect()
    }

    /// The image in 8 bits.
    ///
    /// # Errors
    /// If a side is not from 1 to [`MAX_SIDE`].
    pub fn to_image(&self) -> Result<Image> {
        let mut image = Image::new(self.width, self.height, [0, 0, 0, 255])?;
        for (pixel, [r, g, b]) in image.pixels_mut().iter_mut().zip(self.colours()) {
            *pixel = [r, g, b, 255];
        }
        if let Some(opacity) = self.opacity() {
            image.pixels_mut().iter_mut().zip(opacity).for_each(|(pixel, a)| pixel[3] = a);
        }
        Ok(image)
    }

    fn to_8_bits(&self, sample: u16) -> u8 {
        (u32::from(sample) * 255 / u32::from(self.largest)).min(255) as u8
    }

    /// The image as EXIF's orientation 1 to 8 says that it is to be seen.
    fn upright(self, orientation: u32) -> Self {
        if !(2..=8).contains(&orientation) {
            return self;
        }
        let (width, height) = (self.width as usize, self.height as usize);
        let swapped = orientation >= 5;
        let (columns, rows) = if swapped { (height, width) } else { (width, height) };
        let mut samples = Vec::with_capacity(self.samples.len());
        for y in 0..rows {
            for x in 0..columns {
                let (right, down) = (columns - 1 - x, rows - 1 - y);
                let (from_x, from_y) = match orientation {
                    2 => (right, y),
                    3 => (right, down),
                    4 => (x, down),
                    5 => (y, x),
                    6 => (y, right),
                    7 => (down, right),
                    _ => (down, x),
                };
                let at = (from_y * width + from_x) * self.channels;
                samples.extend_from_slice(&self.samples[at..at + self.channels]);
            }
        }
        Self { width: columns as u32, height: rows as u32, samples, turned: true, ..self }
    }
}

/// EXIF's orientation, 1 to 8; 1 if there is none.
fn orientation(exif: Option<&[u8]>) -> u32 {
    let read = |bytes: &[u8]| {
        let exif = exif::Reader::new().read_raw(bytes.to_vec()).ok()?;
        exif.get_field(exif::Tag::Orientation, exif::In::PRIMARY)?.value.get_uint(0)
    };
    exif.and_then(read).unwrap_or(1)
}

/// Checks the size of an image of `bits` bits a pixel against its file.
fn check_size(width: usize, height: usize, bits: usize, file: usize) -> Result<(), String> {
    let side = MAX_SIDE as usize;
    if width == 0 || height == 0 || width > side || height > side {
        return Err(format!("{width}×{height} pixels: each side must be from 1 to {side}"));
    }
    let bytes = (width * height) as u64 * bits as u64 / 8;
    if bytes / MAX_RATIO > file as u64 {
        return Err(format!("{width}×{height} pixels in {file} bytes: the file is cut off"));
    }
    Ok(())
}

fn png(bytes: &[u8]) -> Result<ImageFile, String> {
    let said = |error: png::DecodingError| error.to_string();
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(said)?;
    let info = reader.info();
    let (width, height) = (info.width as usize, info.height as usize);
    let (channels, depth) = (info.color_type.samples(), info.bit_depth as usize);
    check_size(width, height, channels * depth, bytes.len())?;
    let trns = info.trns.as_deref().map(<[u8]>::to_vec);
    let palette = info.palette.as_deref().map(|palette| {
        let alpha = |at: usize| trns.as_ref().and_then(|t| t.get(at)).copied().unwrap_or(255);
        let colours = palette.as_chunks::<3>().0.iter().enumerate();
        colours.map(|(at, &[r, g, b])| [r, g, b, alpha(at)]).collect::<Vec<_>>()
    });
    let indexed = info.color_type == png::ColorType::Indexed;
    if indexed && palette.is_none() {
        return Err("the palette is missing".into());
    }
    let palette = palette.filter(|_| indexed);
    // Below 16 bits the decoder keeps one byte of each sample.
    let transparent = trns.filter(|_| !indexed).map(|t| match depth {
        16 => t.as_chunks::<2>().0.iter().map(|&pair| u16::from_be_bytes(pair)).collect(),
        _ => t.iter().take(channels).map(|&sample| u16::from(sample)).collect::<Vec<_>>(),
    });
    let exif = info.exif_metadata.as_deref().map(<[u8]>::to_vec);
    let size = reader.output_buffer_size().ok_or("larger than memory")?;
    let mut raw = vec![0; size];
    let frame = reader.next_frame(&mut raw).map_err(said)?;
    let mut samples = Vec::with_capacity(width * height * channels);
    for row in raw.chunks_exact(frame.line_size).take(height) {
        let count = width * channels;
        match depth {
            16 => {
                let pairs = row.as_chunks::<2>().0.iter().take(count);
                samples.extend(pairs.map(|&pair| u16::from_be_bytes(pair)));
            }
            8 => samples.extend(row.iter().take(count).map(|&byte| u16::from(byte))),
            _ => {
                let sample = |at: usize| {
                    let bit = at * depth;
                    u16::from(row[bit / 8]) >> (8 - depth - bit % 8) & ((1 << depth) - 1)
                };
                samples.extend((0..count).map(sample));
            }
        }
    }
    let file = ImageFile {
        format: ImageFormat::Png,
        width: width as u32,
        height: height as u32,
        channels,
        largest: ((1u32 << depth) - 1) as u16,
        samples,
        transparent: transparent.filter(|colour| colour.len() == channels),
        palette,
        turned: false,
    };
    Ok(file.upright(orientation(exif.as_deref())))
}

fn jpeg(bytes: &[u8]) -> Result<ImageFile, String> {
    let options = DecoderOptions::default()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize);
    let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(|error| error.to_string())?;
    let info = decoder.info().ok_or("JPEG without a header")?;
    let (width, height) = (usize::from(info.width), usize::from(info.height));
    check_size(width, height, 24, bytes.len())?;
    // The end of the image; what cameras append may follow.
    if !bytes[bytes.len() / 2..].windows(2).any(|pair| pair == [0xff, 0xd9]) {
        return Err("the JPEG image is cut off: copy or download the file again".into());
    }
    let pixels = decoder.decode().map_err(|error| error.to_string())?;
    if pixels.len() != width * height * 3 {
        return Err(format!("{} bytes of pixels, expected {width}×{height}×3", pixels.len()));
    }
    let file = ImageFile {
        format: ImageFormat::Jpeg,
        width: width as u32,
        height: height as u32,
        channels: 3,
        largest: 255,
        samples: pixels.into_iter().map(u16::from).collect(),
        palette: None,
        transparent: None,
        turned: false,
    };
    Ok(file.upright(orientation(decoder.exif().map(Vec::as_slice))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(name: &str, bytes: &[u8]) -> (tempfile::TempDir, Result<ImageFile>) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let read = ImageFile::read(&path);
        (directory, read)
    }

    fn encoded(
        size: [u32; 2],
        (colour, depth): (png::ColorType, png::BitDepth),
        data: &[u8],
        extra: impl FnOnce(&mut png::Encoder<'_, &mut Vec<u8>>),
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        extra(&mut encoder);
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        bytes
    }

    #[test]
    fn samples_of_every_depth_are_those_of_the_file() {
        use png::{BitDepth as Depth, ColorType as Colour};
        let grey = |depth, data: &[u8]| {
            written("a.png", &encoded([3, 2], (Colour::Grayscale, depth), data, |_| {})).1.unwrap()
        };
        let one = grey(Depth::One, &[0b1010_0000, 0b0110_0000]);
        assert_eq!((one.samples(), one.largest()), (&[1, 0, 1, 0, 1, 1][..], 1));
        assert_eq!(one.colours()[0], [255; 3]);
        let two = grey(Depth::Two, &[0b1101_1000, 0b0010_0100]);
        assert_eq!((two.samples(), two.largest()), (&[3, 1, 2, 0, 2, 1][..], 3));
        let four = grey(Depth::Four, &[0x1f, 0x20, 0x34, 0x50]);
        assert_eq!((four.samples(), four.largest()), (&[1, 15, 2, 3, 4, 5][..], 15));
        let deep = grey(Depth::Sixteen, &[0, 1, 1, 0, 255, 255, 0, 0, 2, 0, 128, 0]);
        assert_eq!(deep.samples(), [1, 256, 65535, 0, 512, 32768]);
        assert_eq!(deep.to_image().unwrap().get(2, 0), Some([255; 4]));
        assert_eq!(deep.opacity(), None);
    }

    #[test]
    fn palettes_and_transparent_colours_are_kept() {
        use png::{BitDepth as Depth, ColorType as Colour};
        let bytes = encoded([2, 2], (Colour::Indexed, Depth::Eight), &[0, 2, 1, 2], |encoder| {
            encoder.set_palette(&[0, 0, 0, 9, 8, 7, 200, 100, 50][..]);
            encoder.set_trns(&[0, 255][..]);
        });
        let file = written("a.png", &bytes).1.unwrap();
        assert_eq!(file.samples(), [0, 2, 1, 2]);
        assert_eq!(file.palette().unwrap()[1], [9, 8, 7, 255]);
        assert_eq!(file.opacity().unwrap(), [0, 255, 255, 255]);
        assert_eq!(file.to_image().unwrap().get(1, 1), Some([200, 100, 50, 255]));
        let bytes = encoded([2, 1], (Colour::Grayscale, Depth::Eight), &[7, 9], |encoder| {
            encoder.set_trns(&[0, 7][..]);
        });
        assert_eq!(written("a.png", &bytes).1.unwrap().opacity().unwrap(), [0, 255]);
    }

    /// TIFF structure with the orientation alone.
    fn exif(orientation: u8) -> Vec<u8> {
        let mut bytes = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        bytes.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
        bytes
    }

    /// The orientations as EXIF's specification words them: the edges that row 0 and column 0 are.
    #[test]
    fn orientations_of_exif_are_honoured() {
        let side = 48u16;
        let quadrant = |x: u16, y: u16| match (x < side / 2, y < side / 2) {
            (true, true) => 0u8,
            (false, true) => 80,
            (true, false) => 160,
            (false, false) => 240,
        };
        let rgb: Vec<u8> = (0..side)
            .flat_map(|y| (0..2 * side).flat_map(move |x| [quadrant(x / 2, y); 3]))
            .collect();
        // Seen image by quadrants: upper left, upper right, lower left, lower right.
        let seen = [
            (1, [0, 80, 160, 240]),
            (2, [80, 0, 240, 160]),
            (3, [240, 160, 80, 0]),
            (4, [160, 240, 0, 80]),
            (5, [0, 160, 80, 240]),
            (6, [160, 0, 240, 80]),
            (7, [240, 80, 160, 0]),
            (8, [80, 240, 0, 160]),
        ];
        for (orientation, expected) in seen {
            let mut bytes = Vec::new();
            let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 95);
            let segment = [b"Exif\0\0".to_vec(), exif(orientation)].concat();
            encoder.add_app_segment(1, &segment).unwrap();
            encoder.encode(&rgb, 2 * side, side, jpeg_encoder::ColorType::Rgb).unwrap();
            let file = written("a.jpg", &bytes).1.unwrap();
            assert_eq!(file.format(), ImageFormat::Jpeg);
            assert_eq!(file.turned(), orientation > 1);
            let (width, height) = (file.width(), file.height());
            let upright = if orientation < 5 { (96, 48) } else { (48, 96) };
            assert_eq!((width, height), upright, "{orientation}");
            let image = file.to_image().unwrap();
            let places = [(1, 1), (3, 1), (1, 3), (3, 3)];
            for ((x, y), wanted) in places.into_iter().zip(expected) {
                let [found, ..] = image.get(x * width / 4, y * height / 4).unwrap();
                assert!(found.abs_diff(wanted) < 6, "{orientation}: {found} {wanted}");
            }
            // A file that is cut off.
            let cut = written("a.jpg", &bytes[..bytes.len() - 40]).1.unwrap_err().to_string();
            assert!(cut.contains("cut off"), "{cut}");
        }
    }

    #[test]
    fn what_is_no_image_is_named() {
        for (bytes, name) in [
            (&b"RIFF\0\0\0\0WEBPVP8 "[..], "WebP"),
            (b"GIF89a", "GIF"),
            (b"\0\0\0\x18ftypheic", "HEIC"),
            (b"<!DOCTYPE html>", "web page"),
            (b"", "empty"),
            (b"hello", "expected a PNG or JPEG"),
            (b"\x89PNG\r\n\x1a\n", ""),
            (b"\xff\xd8\xff\xe0", ""),
        ] {
            let message = written("a.png", bytes).1.unwrap_err().to_string();
            assert!(message.contains(name) && message.contains("a.png"), "{message}");
        }
        // A header that claims more than the file can have.
        let mut bytes =
            encoded([4, 4], (png::ColorType::Grayscale, png::BitDepth::Sixteen), &[0; 32], |_| {});
        bytes[16..24].copy_from_slice(&[0, 0, 0x3f, 0xff, 0, 0, 0x3f, 0xff]);
        assert!(written("a.png", &bytes).1.is_err());
    }
}
