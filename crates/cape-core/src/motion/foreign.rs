//! Explanations of files that hold no poses of SMPL.

use super::{content::Entry, layout::JOINTS};

/// Numbers of a frame of the features of HumanML3D, of KIT-ML, and of whole bodies in their manner.
const FEATURES: [usize; 3] = [263, 251, 623];
/// Numbers of joints of skeletons whose positions are given, beside SMPL's.
const SKELETONS: [usize; 7] = [14, 17, 19, 21, 25, 133, 127];

/// Explanation of a format that holds no SMPL poses, from its first bytes.
pub(super) fn named(head: &[u8]) -> Option<&'static str> {
    let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start();
    let begins = |with: &[u8]| text.starts_with(with);
    Some(match head {
        _ if begins(b"HIERARCHY") => {
            "a BVH file: its skeleton is not SMPL's; convert the motion to SMPL poses first"
        }
        _ if begins(b"Kaydara") || begins(b"; FBX") => {
            "an FBX file: export the poses of SMPL's joints as .npz"
        }
        _ if begins(b"glTF") => "a glTF file: expected a file of poses (.npz, .npy, .pkl, .csv)",
        _ if begins(b"PXR-USDC") || begins(b"#usda") => {
            "a USD file: expected a file of poses (.npz, .npy, .pkl, .csv)"
        }
        _ if begins(b"PathFileType") => {
            "a TRC file of marker positions: fit SMPL to them, such as by MoSh, and give its poses"
        }
        [2..=15, b'P', _, _, ..] => {
            "a C3D file of marker positions: fit SMPL to them, such as by MoSh, and give its poses"
        }
        _ if begins(b"Vocaloid Motion Data") => {
            "a VMD file: its skeleton is not SMPL's; convert the motion to SMPL poses first"
        }
        [0x89, b'H', b'D', b'F', ..] => {
            "an HDF5 file (MATLAB's since 7.3 are too): read its arrays by h5py and save them by \
             `numpy.savez`"
        }
        // The number by which PyTorch's files began before they were archives.
        [0x80, 2, 0x8a, 0x0a, 0x6c, 0xfc, 0x9c, 0x46, 0xf9, ..] => crate::npy::PYTORCH_FILE,
        _ if begins(b"version https://git-lfs") => {
            "a Git LFS pointer: fetch the file itself with `git lfs pull`"
        }
        _ if begins(b"<") => "a web page, not a file of poses: download it again",
        [0xfd, b'7', b'z', b'X', b'Z', ..]
        | [b'B', b'Z', b'h', ..]
        | [0x04, 0x22, 0x4d, 0x18, ..] => {
            "compressed by xz, bzip2 or lz4: save it uncompressed or with zlib (joblib's `compress=3`)"
        }
        _ => return None,
    })
}

/// Explanation of content without poses of SMPL: features, positions, quaternions, or a shape alone.
pub(super) fn explanation(root: &Entry) -> Option<String> {
    let mut arrays = Vec::new();
    gather("", root, &mut arrays);
    arrays.iter().find_map(|(name, shape)| of_array(name, shape)).or_else(|| {
        let has = |part: &str| arrays.iter().any(|(name, _)| name.ends_with(part));
        let small = arrays.iter().all(|(_, shape)| shape.iter().product::<usize>() <= 512);
        (has("betas") && small).then(|| {
            format!(
                "the shape of a subject without poses, as AMASS has beside the motions of each; the file \
                 has {}",
                root.describe()
            )
        })
    })
}

fn gather<'e>(name: &'e str, entry: &'e Entry, arrays: &mut Vec<(&'e str, &'e [usize])>) {
    match entry {
        Entry::Map(entries) => {
            for (name, entry) in entries {
                gather(name, entry, arrays);
            }
        }
        Entry::List(entries) => {
            for entry in entries {
                gather(name, entry, arrays);
            }
        }
        Entry::Numbers(numbers) => arrays.push((name, &numbers.shape)),
        Entry::Text(_) | Entry::Other(_) => {}
    }
}

fn of_array(name: &str, shape: &[usize]) -> Option<String> {
    let title = if name.is_empty() { String::new() } else { format!("`{name}` ") };
    match shape {
        [.., width] if FEATURES.contains(width) && shape.len() < 4 => Some(format!(
            "{title}{shape:?} are features of HumanML3D's kind, not rotations of SMPL's joints: recover the \
             positions of the joints from them, fit SMPL to these and give its poses"
        )),
        [.., joints, 4] if JOINTS.contains(joints) => Some(format!(
            "{title}{shape:?} are quaternions, expected axis-angles [n, {joints}, 3] or matrices \
             [n, {joints}, 3, 3]: convert them, such as by `scipy.spatial.transform.Rotation`"
        )),
        [.., joints, 3, _] | [.., joints, 3] if is_skeleton(name, *joints) => Some(format!(
            "{title}{shape:?} are positions of joints, not rotations: fit SMPL to them and give its poses"
        )),
        [72, frames] if *frames != 72 => Some(format!(
            "{title}{shape:?} has frames in columns, expected [{frames}, 72]: transpose it"
        )),
        _ => None,
    }
}

/// True for arrays of positions by their name or number of joints.
fn is_skeleton(name: &str, joints: usize) -> bool {
    let said = ["joints", "keypoints", "kp3d", "motion"].iter().any(|part| name.contains(part));
    SKELETONS.contains(&joints) || (said && joints < 150)
}
