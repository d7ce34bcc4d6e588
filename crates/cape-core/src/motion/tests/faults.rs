//! Files without poses, and with wrong numbers.

use super::*;

#[test]
fn positions_of_joints_are_not_taken_for_rotations() {
    let files = Files::new();
    let mut positions = Array3::<f64>::zeros((FRAMES, 22, 3));
    for frame in 0..FRAMES {
        let turn = DQuat::from_rotation_y(0.1 * frame as f64);
        for joint in 1..22 {
            let parent = crate::joints::PARENTS[joint].unwrap();
            let bone = turn * DVec3::new(0.02 * joint as f64, 0.1, 0.03);
            for axis in 0..3 {
                positions[(frame, joint, axis)] = positions[(frame, parent, axis)] + bone[axis];
            }
        }
    }
    let path = files.path("joints.npy");
    write_npy(&path, &positions).unwrap();
    assert!(error(&path).contains("positions of joints"), "{}", error(&path));
}

#[test]
fn files_without_poses_say_what_they_have() {
    let files = Files::new();
    // AMASS's file of a subject's shape.
    let path = files.npz("male_stageii.npz", |arrays| {
        arrays.text("gender", "male").add("betas", &Array1::zeros(10));
    });
    let message = error(&path);
    assert!(message.contains("shape of a subject without poses"), "{message}");
    assert!(message.contains("the file has gender (text), betas [10]"), "{message}");
    let path = files.npz("cameras.npz", |arrays| {
        arrays.text("name", "front").add("focal", &Array1::zeros(2));
    });
    let message = error(&path);
    assert!(message.contains("the file has name (text), focal [2]"), "{message}");
    assert!(message.contains("global_orient"), "{message}");
    // SMPLify-X before decoding by its pose prior.
    let encoded = Py::dict([("body_pose", Py::array(&Array2::zeros((1, 32))))]);
    let path = files.bytes("000.pkl", &pickle(&encoded, false));
    assert!(error(&path).contains("body_pose [1, 32]"), "{}", error(&path));
    for (bytes, expected) in [
        (&b"HIERARCHY\nROOT Hips\n"[..], "BVH"),
        (b"<!DOCTYPE html>", "web page"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
        (b"", "empty"),
        (b"\x00\x01\x02\xff\xfe", "unknown kind"),
        (b"{\"poses\": [[1, 2", "not JSON"),
    ] {
        let path = files.bytes("a.npz", bytes);
        assert!(error(&path).contains(expected), "{}", error(&path));
    }
    let mut broken = poses();
    broken[(1, 28)] = f64::NAN;
    let path = files.path("nan.npy");
    write_npy(&path, &broken).unwrap();
    assert!(error(&path).contains("number 28 of frame 1"), "{}", error(&path));
    write_npy(&path, &Array2::<f64>::zeros((0, 72))).unwrap();
    assert!(error(&path).contains("no pose"), "{}", error(&path));
    let path = files.npz("short.npz", |arrays| {
        arrays.add("poses", &poses()).add("trans", &Array2::zeros((FRAMES - 1, 3)));
    });
    assert!(error(&path).contains("`trans`: shape [5, 3], expected [6, 3]"), "{}", error(&path));
    // PyTorch's tensors and files.
    let mut tensor = vec![0x80, 4, 0x8c, 12];
    tensor.extend(b"torch._utils\x8c\x12_rebuild_tensor_v2\x93.");
    let path = files.bytes("tensors.pkl", &tensor);
    assert!(error(&path).contains(".cpu().numpy()"), "{}", error(&path));
    let mut archive = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    archive.start_file("archive/data.pkl", zip::write::SimpleFileOptions::default()).unwrap();
    archive.finish().unwrap();
    assert!(error(&path).contains("PyTorch") && error(&path).contains("numpy.savez"));
    let legacy = [&[0x80, 2, 0x8a, 10][..], &0x1950_a86a_20f9_469c_fc6c_u128.to_le_bytes()[..10]];
    let path = files.bytes("model.pth", &legacy.concat());
    assert!(error(&path).contains("PyTorch"), "{}", error(&path));
}
