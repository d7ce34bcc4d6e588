//! Images of a directory, with their keypoints and masks found by name.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use cape_core::list_files;

use crate::error::{Error, Result};

const KEYPOINTS: [&str; 2] = ["json", "npz"];
const IMAGES: [&str; 3] = ["png", "jpg", "jpeg"];
const MASKS: [&str; 6] = ["png", "jpg", "jpeg", "npy", "npz", "json"];
/// Ends of the names of detectors' files, which the images do not have.
const ENDS: [&str; 9] =
    ["keypoints", "mask", "masks", "seg", "segmentation", "silhouette", "matte", "alpha", "pose"];

/// Files of one image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ImageItem {
    /// Name of the image without endings.
    pub(crate) name: String,
    pub(crate) keypoints: PathBuf,
    /// Mask; the error says that it is missing.
    pub(crate) mask: Result<Option<PathBuf>, String>,
    pub(crate) image: Option<PathBuf>,
}

/// Keypoints, masks and images as given, each a file for all or a directory.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ImageSources<'a> {
    pub(crate) keypoints: &'a Path,
    pub(crate) masks: Option<&'a Path>,
    pub(crate) images: Option<&'a Path>,
}

impl ImageSources<'_> {
    /// The images in natural order of their names: those with keypoints, if these are a directory, else
    /// the photographs or masks.
    pub(crate) fn items(self) -> Result<Vec<ImageItem>> {
        let listed = |path: Option<&Path>, kinds: &[&str]| match path {
            Some(path) if path.is_dir() => by_name(path, kinds).map(Some),
            _ => Ok(None),
        };
        let keypoints = listed(Some(self.keypoints), &KEYPOINTS)?;
        let masks = listed(self.masks, &MASKS)?;
        let images = listed(self.images, &IMAGES)?;
        let of_all = |path: Option<&Path>| path.map(Path::to_owned);
        let Some(named) = keypoints.as_ref().or(images.as_ref()).or(masks.as_ref()) else {
            let (mask, image) = (Ok(of_all(self.masks)), of_all(self.images));
            let name = name_of(self.keypoints);
            return Ok(vec![ImageItem { name, keypoints: self.keypoints.to_owned(), mask, image }]);
        };
        let found = |files: &Option<FilesByName>, all: Option<&Path>, name: &str| match files {
            Some(files) => files.paths.get(name).cloned(),
            None => of_all(all),
        };
        let items = named.order.iter().map(|name| {
            let mask = match (found(&masks, self.masks, name), self.masks) {
                (None, Some(directory)) => {
                    Err(format!("no mask of this name in {}", directory.display()))
                }
                (mask, _) => Ok(mask),
            };
            let keypoints = found(&keypoints, Some(self.keypoints), name);
            let image = found(&images, self.images, name);
            keypoints.map(|keypoints| ImageItem { name: name.clone(), keypoints, mask, image })
        });
        Ok(items.flatten().collect())
    }
}

/// Files of a directory by the names of their images.
#[derive(Debug)]
struct FilesByName {
    /// Names in natural order.
    order: Vec<String>,
    paths: BTreeMap<String, PathBuf>,
}

fn by_name(directory: &Path, kinds: &[&str]) -> Result<FilesByName> {
    let kind = |path: &Path| {
        let end = path.extension().and_then(|end| end.to_str()).map(str::to_lowercase);
        end.is_some_and(|end| kinds.contains(&end.as_str()))
    };
    let (mut order, mut paths) = (Vec::new(), BTreeMap::<String, PathBuf>::new());
    for path in list_files(directory, |path| kind(path) && !path.is_dir())? {
        let name = name_of(&path);
        if let Some(other) = paths.get(&name) {
            return Err(Error::message(format!(
                "{} and {} are both of the image `{name}`: expected one file of each image",
                other.display(),
                path.display()
            )));
        }
        order.push(name.clone());
        paths.insert(name, path);
    }
    if order.is_empty() {
        return Err(Error::message(format!(
            "{}: no files, expected names ending in .{}",
            directory.display(),
            kinds.join(", .")
        )));
    }
    Ok(FilesByName { order, paths })
}

/// Name of the image that a file belongs to: without `.json`, `.jpg`, …, `_keypoints`, `_mask` and the
/// like.
fn name_of(path: &Path) -> String {
    let mut name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    loop {
        let kept = name.rsplit_once('.').and_then(|(stem, end)| {
            let end = end.to_lowercase();
            let known = MASKS.iter().chain(&IMAGES).chain(&KEYPOINTS);
            known.into_iter().any(|kind| *kind == end).then_some(stem)
        });
        let kept = kept.or_else(|| {
            let (stem, end) = name.rsplit_once(['_', '-', '.'])?;
            ENDS.contains(&end.to_lowercase().as_str()).then_some(stem)
        });
        match kept {
            Some(kept) if !kept.is_empty() => name = kept.to_owned(),
            _ => return name,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn names_are_those_of_the_images() {
        for (file, name) in [
            ("walk_000012_keypoints.json", "walk_000012"),
            ("IMG 4.JPG", "IMG 4"),
            ("a.b.jpg.json", "a.b"),
            ("person-mask.png", "person"),
            ("frame7_mask_alpha.png", "frame7"),
            ("mask.png", "mask"),
        ] {
            assert_eq!(name_of(Path::new(file)), name, "{file}");
        }
    }

    #[test]
    fn files_of_one_image_come_together() {
        let root = tempfile::tempdir().unwrap();
        for (directory, file) in [
            ("poses", "f10_keypoints.json"),
            ("poses", "f9_keypoints.json"),
            ("poses", ".f8_keypoints.json"),
            ("poses", "readme.txt"),
            ("masks", "f9.png"),
            ("photos", "f9.jpg"),
            ("photos", "f10.jpg"),
            ("photos", "f11.jpg"),
        ] {
            fs::create_dir_all(root.path().join(directory)).unwrap();
            fs::write(root.path().join(directory).join(file), "").unwrap();
        }
        let [poses, masks, photos] =
            ["poses", "masks", "photos"].map(|name| root.path().join(name));
        let sources =
            ImageSources { keypoints: &poses, masks: Some(&masks), images: Some(&photos) };
        let items = sources.items().unwrap();
        let names: Vec<&str> = items.iter().map(|item| item.name.as_str()).collect();
        assert_eq!(names, ["f9", "f10"]);
        assert_eq!(items[0].mask, Ok(Some(masks.join("f9.png"))));
        assert!(items[1].mask.as_ref().unwrap_err().contains("no mask"));
        assert_eq!(items[1].image, Some(photos.join("f10.jpg")));
        // One file for all images.
        let all = root.path().join("results.json");
        let items = ImageSources { keypoints: &all, masks: None, images: Some(&photos) };
        let items = items.items().unwrap();
        assert_eq!((items.len(), &items[2].keypoints, &items[2].mask), (3, &all, &Ok(None)));
        fs::write(masks.join("f9_mask.png"), "").unwrap();
        let twice = sources.items().unwrap_err().to_string();
        assert!(twice.contains("f9.png") && twice.contains("f9_mask.png"), "{twice}");
    }
}
