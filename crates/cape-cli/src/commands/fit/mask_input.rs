//! Silhouette, image and size of an image that a body is fitted to.

use std::{
    path::{Path, PathBuf},
    str::FromStr,
};

use cape_fit::{
    KeypointOptions, Keypoints, Mask, People, PinholeCamera,
    silhouette::{MaskLabel, is_annotation, read_annotated_mask},
};
use cape_render::{Image, ImageFile};
use clap::Args;

use crate::error::{Context, Error, Result};

/// Silhouette and size of the image.
#[derive(Debug, Clone, Args)]
pub(crate) struct MaskArgs {
    /// Silhouette of the person in an image of the photograph's size: PNG or JPEG (white on black, a
    /// cut-out, or a label image with --labels), .npy, .npz, or COCO annotations (.json).
    /// Without it the clothing is hardly observed.
    #[arg(long, visible_alias = "masks", value_name = "MASK")]
    pub(crate) mask: Option<PathBuf>,
    /// Labels of the person in a label image, numbers or colours: 9,12 or #c08080.
    #[arg(long, value_name = "LABELS", value_delimiter = ',', requires = "mask")]
    labels: Vec<MaskLabel>,
    /// Mask of what hides the person: pixels that count neither as the person nor as background.
    #[arg(long, value_name = "MASK", requires = "mask")]
    occluders: Option<PathBuf>,
    /// Width and height of the image in pixels [default: those of --image, --mask or the keypoint file].
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    image_size: Option<ImageSize>,
    /// Photograph to draw the overlay on, PNG or JPEG.
    #[arg(long, visible_alias = "images", value_name = "IMAGE")]
    pub(crate) image: Option<PathBuf>,
}

/// Width and height, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ImageSize([u32; 2]);

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides = text.split_once(['x', 'X', '×']);
        let side = |text: &str| text.trim().parse().ok().filter(|&side: &u32| side > 0);
        sides
            .and_then(|(width, height)| Some(Self([side(width)?, side(height)?])))
            .ok_or_else(|| "expected width and height such as 640x480".into())
    }
}

/// Silhouette, occluders, size and photograph of an image whose keypoints are not yet read.
pub(crate) struct MaskInput<'a> {
    args: &'a MaskArgs,
    /// Silhouette; `None` if it is to be read from annotations.
    pub(crate) mask: Option<Mask>,
    occluders: Option<Mask>,
    /// Width and height, if known, pixels.
    pub(crate) size: Option<[u32; 2]>,
    /// Photograph, upright.
    pub(crate) image: Option<Image>,
    /// Remarks on how the files were read.
    pub(crate) notes: Vec<String>,
}

impl MaskArgs {
    /// The same options for the files of one image.
    pub(crate) fn with_files(&self, mask: Option<PathBuf>, image: Option<PathBuf>) -> Self {
        Self { mask, image, ..self.clone() }
    }

    /// Labels as they were given, or nearly.
    pub(crate) fn label_names(&self) -> Vec<String> {
        self.labels.iter().map(|label| format!("{label:?}")).collect()
    }

    /// Size of the image that was given, pixels.
    pub(crate) fn size(&self) -> Option<[u32; 2]> {
        self.image_size.map(|size| size.0)
    }

    /// Reads image and mask of one image.
    pub(crate) fn read(&self) -> Result<MaskInput<'_>> {
        let mut notes = Vec::new();
        let image = match &self.image {
            Some(path) => {
                let file = ImageFile::read(path)?;
                if file.turned() {
                    notes.push(
                        "note: the photograph is turned upright by its EXIF orientation; keypoints and \
                         mask are taken to be of the upright image"
                            .to_owned(),
                    );
                }
                Some(file.to_image()?)
            }
            None => None,
        };
        let mask = match &self.mask {
            Some(path) if !is_annotation(path) => {
                let mask = Mask::load_labels(path, &self.labels)?;
                let camera = PinholeCamera::new(mask.width(), mask.height(), None)?;
                mask.check(&camera).doing(|| self.reading())?;
                Some(mask)
            }
            _ => None,
        };
        let occluders = match &self.occluders {
            Some(path) => Some(Mask::load(path)?),
            None => None,
        };
        let sizes = [
            ("--image-size", self.image_size.map(|size| size.0)),
            ("--image", image.as_ref().map(|image| [image.width(), image.height()])),
            ("--mask", mask.as_ref().map(Mask::size)),
            ("--occluders", occluders.as_ref().map(Mask::size)),
        ];
        let mut known = sizes.into_iter().filter_map(|(name, size)| Some((name, size?)));
        let first = known.next();
        if let Some((name, [width, height])) = first
            && let Some((other, [w, h])) = known.find(|(_, size)| *size != [width, height])
        {
            let turned = if [w, h] == [height, width] {
                ": one of them is turned by 90°"
            } else {
                ": both must be of the same size"
            };
            return Err(Error::message(format!(
                "{other}: {w}×{h} pixels, but {name} has {width}×{height}{turned}"
            )));
        }
        let size = first.map(|(_, size)| size);
        Ok(MaskInput { args: self, mask, occluders, size, image, notes })
    }

    /// Description of reading the mask, for errors.
    pub(crate) fn reading(&self) -> String {
        let path = self.mask.as_deref().unwrap_or(Path::new(""));
        format!("reading {}", path.display())
    }

    /// File names by which a file of several images is searched.
    pub(crate) fn names(&self) -> Vec<String> {
        let paths = self.image.iter().chain(&self.mask);
        paths.filter_map(|path| Some(path.file_name()?.to_str()?.to_owned())).collect()
    }
}

impl MaskInput<'_> {
    /// Silhouette and size of the image, given the person with the index `person` of `people`, read
    /// from `file` with `options`. Masks that are not the person's are refused.
    pub(crate) fn for_person(
        self,
        (people, person, keypoints): (&People, usize, &Keypoints),
        file: &Path,
        options: &KeypointOptions,
    ) -> Result<PersonMask> {
        let size = self.size.or(people.size());
        let mask = match (self.mask, &self.args.mask) {
            (Some(mask), _) => Some(mask),
            (None, Some(path)) => {
                let reading = || format!("reading {}", path.display());
                let own = (path == file).then(|| &people.all()[person].segmentation);
                Some(if let Some(Some(outline)) = own {
                    Mask::from_segmentation(outline, size).doing(reading)?
                } else {
                    let options = KeypointOptions { size, ..options.clone() };
                    read_annotated_mask(path, keypoints, &options).doing(reading)?
                })
            }
            (None, None) => None,
        };
        let of_mask = mask.as_ref().map(Mask::size);
        let Some(size) = size.or(of_mask) else {
            return Err(Error::message(
                "the size of the image is unknown: give the photograph by --image, a mask, or \
                 --image-size WIDTHxHEIGHT",
            ));
        };
        if let Some([w, h]) = of_mask.filter(|of_mask| *of_mask != size) {
            let [width, height] = size;
            return Err(Error::message(format!(
                "--mask: {w}×{h} pixels, but the image has {width}×{height}: both must be of the \
                 same size"
            )));
        }
        Ok(PersonMask { mask, occluders: self.occluders, size, image: self.image })
    }
}

/// Silhouette of a person, what hides it, size of the image, and photograph.
pub(crate) struct PersonMask {
    pub(crate) mask: Option<Mask>,
    pub(crate) occluders: Option<Mask>,
    pub(crate) size: [u32; 2],
    pub(crate) image: Option<Image>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_width_and_height() {
        assert_eq!("640x480".parse(), Ok(ImageSize([640, 480])));
        assert_eq!("640 × 480".parse(), Ok(ImageSize([640, 480])));
        for text in ["640", "0x480", "axb", "640x480x3", ""] {
            assert!(text.parse::<ImageSize>().is_err(), "{text}");
        }
    }
}
