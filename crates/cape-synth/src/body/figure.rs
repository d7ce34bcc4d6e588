//! Joint positions and implicit parts of the synthetic body.
//!
//! A neutral adult of about 1.70 m in the T-pose, left half (x ≥ 0), in metres.

use glam::{DQuat, DVec3};

use cape_core::joints::{JOINTS, PARENTS};

use super::sdf::{Blob, BodySdf, CrossSection, Primitive, SdfPart, Tube};

/// Parent of `joint`; the root is its own parent.
pub(super) fn parent(joint: usize) -> usize {
    PARENTS[joint].unwrap_or(0)
}

/// Mirror joint on the other side of the body.
pub(super) const MIRRORED: [usize; JOINTS] =
    [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22];

/// Joint positions, metres, `[24]`.
pub(super) fn joints() -> [DVec3; JOINTS] {
    const LEFT_AND_MIDDLE: [(usize, [f64; 3]); 15] = [
        (0, [0.0, -0.228, 0.006]),
        (1, [0.078, -0.315, 0.002]),
        (3, [0.0, -0.112, -0.012]),
        (4, [0.102, -0.692, 0.002]),
        (6, [0.0, 0.022, -0.016]),
        (7, [0.098, -1.083, -0.034]),
        (9, [0.0, 0.078, -0.012]),
        (10, [0.116, -1.136, 0.088]),
        (12, [0.0, 0.276, -0.018]),
        (13, [0.078, 0.196, -0.012]),
        (15, [0.0, 0.352, 0.022]),
        (16, [0.172, 0.222, -0.022]),
        (18, [0.432, 0.213, -0.040]),
        (20, [0.682, 0.216, -0.045]),
        (22, [0.768, 0.214, -0.046]),
    ];
    let mut joints = [DVec3::ZERO; JOINTS];
    for (joint, [x, y, z]) in LEFT_AND_MIDDLE {
        joints[MIRRORED[joint]] = DVec3::new(-x, y, z);
        joints[joint] = DVec3::new(x, y, z);
    }
    joints
}

/// Signed distance field of the whole body.
pub(super) fn body_sdf() -> BodySdf {
    let mut sdf = BodySdf::default();
    torso(&mut sdf);
    neck_and_head(&mut sdf);
    leg(&mut sdf);
    foot(&mut sdf);
    arm(&mut sdf);
    hand(&mut sdf);
    sdf
}

fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

fn ellipsoid(centre: DVec3, radii: DVec3) -> Primitive {
    rotated_ellipsoid(centre, radii, DVec3::ZERO)
}

fn rotated_ellipsoid(centre: DVec3, radii: DVec3, axis_angle: DVec3) -> Primitive {
    Primitive::Ellipsoid { centre, radii, rotation: DQuat::from_scaled_axis(axis_angle) }
}

fn chain(nodes: &[([f64; 3], f64)]) -> Primitive {
    Primitive::Chain(
        nodes.iter().map(|&(centre, radius)| (DVec3::from_array(centre), radius)).collect(),
    )
}

fn blob(centre: DVec3, spread: DVec3, millimetres: f64) -> Blob {
    Blob { centre, spread, amplitude: millimetres / 1000.0 }
}

/// Tube along y, symmetric in x, of rows (y, centre x, half-width, front z, back z).
fn column(exponent: f64, caps: [f64; 2], rows: &[[f64; 5]]) -> Primitive {
    let sections: Vec<CrossSection> = rows
        .iter()
        .map(|&[at, x, half, front, back]| CrossSection {
            at,
            centre: [x, f64::midpoint(front, back)],
            half: [half, half, (front - back) / 2.0, (front - back) / 2.0],
        })
        .collect();
    Primitive::Tube(Tube::new(1, exponent, caps, &sections))
}

fn torso(sdf: &mut BodySdf) {
    let trunk = column(
        2.35,
        [0.03, 0.03],
        &[
            [-0.360, 0.0, 0.095, 0.060, -0.070],
            [-0.320, 0.0, 0.142, 0.086, -0.100],
            [-0.260, 0.0, 0.160, 0.100, -0.106],
            [-0.200, 0.0, 0.154, 0.104, -0.098],
            [-0.140, 0.0, 0.139, 0.102, -0.084],
            [-0.080, 0.0, 0.129, 0.097, -0.076],
            [-0.020, 0.0, 0.129, 0.096, -0.082],
            [0.040, 0.0, 0.137, 0.102, -0.096],
            [0.100, 0.0, 0.145, 0.104, -0.109],
            [0.160, 0.0, 0.147, 0.096, -0.115],
            [0.210, 0.0, 0.136, 0.072, -0.106],
            [0.250, 0.0, 0.096, 0.042, -0.086],
            [0.280, 0.0, 0.060, 0.030, -0.070],
        ],
    );
    sdf.parts.push(SdfPart::new(trunk, 0.03));
    // Pectorals, shoulder blades, the broad muscle of the back, buttocks.
    let parts = [
        (
            rotated_ellipsoid(v(0.072, 0.122, 0.062), v(0.074, 0.056, 0.043), v(0.0, 0.25, 0.12)),
            0.03,
        ),
        (
            rotated_ellipsoid(v(0.082, 0.140, -0.088), v(0.052, 0.078, 0.034), v(0.0, 0.0, 0.2)),
            0.04,
        ),
        (ellipsoid(v(0.102, 0.095, -0.036), v(0.046, 0.125, 0.056)), 0.05),
        (
            rotated_ellipsoid(v(0.074, -0.315, -0.058), v(0.074, 0.082, 0.074), v(0.0, 0.0, 0.0)),
            0.04,
        ),
    ];
    sdf.parts.extend(parts.into_iter().map(|(form, blend)| SdfPart::new(form, blend).mirrored()));
    sdf.blobs.extend([
        // Furrow of the spine, breastbone, mid-line of the belly, navel.
        blob(v(0.0, 0.10, -0.115), v(0.016, 0.090, 0.05), -5.0),
        blob(v(0.0, -0.08, -0.080), v(0.016, 0.080, 0.05), -6.0),
        blob(v(0.0, 0.12, 0.105), v(0.014, 0.045, 0.04), -4.0),
        blob(v(0.0, -0.02, 0.100), v(0.013, 0.070, 0.04), -4.5),
        blob(v(0.0, -0.118, 0.105), v(0.009, 0.010, 0.03), -6.0),
        // Rib arch, flanks, iliac crest, groin.
        blob(v(0.068, 0.030, 0.085), v(0.030, 0.020, 0.04), 2.5),
        blob(v(0.085, -0.030, 0.075), v(0.018, 0.050, 0.04), -3.0),
        blob(v(0.128, -0.170, 0.030), v(0.025, 0.022, 0.05), 4.0),
        blob(v(0.075, -0.325, 0.085), v(0.035, 0.018, 0.04), -4.0),
        // Collar bones and the hollows above them.
        blob(v(0.050, 0.236, 0.040), v(0.030, 0.008, 0.03), 5.0),
        blob(v(0.110, 0.246, 0.020), v(0.030, 0.008, 0.03), 5.0),
        blob(v(0.060, 0.258, 0.025), v(0.025, 0.010, 0.03), -5.0),
        blob(v(0.0, 0.240, 0.050), v(0.010, 0.010, 0.03), -4.0),
    ]);
}

fn neck_and_head(sdf: &mut BodySdf) {
    let neck = column(
        2.0,
        [0.02, 0.02],
        &[
            [0.200, 0.0, 0.066, 0.040, -0.085],
            [0.260, 0.0, 0.060, 0.036, -0.080],
            [0.300, 0.0, 0.055, 0.042, -0.066],
            [0.350, 0.0, 0.054, 0.056, -0.056],
            [0.400, 0.0, 0.056, 0.060, -0.052],
        ],
    );
    sdf.parts.push(SdfPart::new(neck, 0.035));
    let trapezius = chain(&[
        ([0.018, 0.325, -0.040], 0.026),
        ([0.052, 0.276, -0.045], 0.026),
        ([0.100, 0.246, -0.040], 0.025),
        ([0.170, 0.230, -0.030], 0.022),
    ]);
    sdf.parts.push(SdfPart::new(trapezius, 0.05).mirrored());

    let skull = ellipsoid(v(0.0, 0.4534, 0.0139), v(0.0777, 0.0966, 0.1008));
    sdf.parts.push(SdfPart::new(skull, 0.03));
    let face = column(
        2.1,
        [0.012, 0.03],
        &[
            [0.3274, 0.0, 0.0252, 0.1042, 0.0464],
            [0.3421, 0.0, 0.0389, 0.1095, 0.0255],
            [0.3652, 0.0, 0.0525, 0.1095, 0.0045],
            [0.3925, 0.0, 0.0609, 0.1095, -0.0008],
            [0.424, 0.0, 0.0672, 0.1095, -0.0008],
            [0.466, 0.0, 0.0693, 0.1095, -0.0008],
        ],
    );
    sdf.parts.push(SdfPart::new(face, 0.03));
    let middle = [
        // Muzzle, chin, nose.
        (ellipsoid(v(0.0, 0.3652, 0.0916), v(0.034, 0.031, 0.025)), 0.025),
        (ellipsoid(v(0.0, 0.3368, 0.0958), v(0.023, 0.018, 0.019)), 0.02),
        (
            chain(&[
                ([0.0, 0.4419, 0.1074], 0.0090),
                ([0.0, 0.4187, 0.1179], 0.0108),
                ([0.0, 0.4004, 0.1241], 0.0130),
            ]),
            0.01,
        ),
    ];
    sdf.parts.extend(middle.into_iter().map(|(form, blend)| SdfPart::new(form, blend)));
    let sides = [
        // Cheek, cheek bone, jaw, brow, eye, wing of the nose.
        (ellipsoid(v(0.0347, 0.3862, 0.079), v(0.0284, 0.0336, 0.0273)), 0.03),
        (ellipsoid(v(0.0483, 0.4124, 0.0727), v(0.0189, 0.0126, 0.0189)), 0.025),
        (chain(&[([0.0515, 0.3840, 0.0223], 0.0150), ([0.0270, 0.3420, 0.0769], 0.0150)]), 0.035),
        (chain(&[([0.0095, 0.4508, 0.1053], 0.0089), ([0.0462, 0.4513, 0.0832], 0.0089)]), 0.016),
        (ellipsoid(v(0.0326, 0.4335, 0.0925), v(0.0140, 0.0095, 0.0140)), 0.003),
        (ellipsoid(v(0.0115, 0.3972, 0.1147), v(0.0086, 0.0076, 0.011)), 0.008),
    ];
    sdf.parts.extend(sides.into_iter().map(|(form, blend)| SdfPart::new(form, blend).mirrored()));
    let ear = [
        (
            rotated_ellipsoid(
                v(0.0785, 0.424, -0.001),
                v(0.0100, 0.0265, 0.0180),
                v(0.15, -0.45, -0.14),
            ),
            0.008,
        ),
        (ellipsoid(v(0.0750, 0.398, 0.006), v(0.0075, 0.012, 0.010)), 0.012),
    ];
    sdf.parts.extend(ear.into_iter().map(|(form, blend)| SdfPart::new(form, blend)));
    sdf.blobs.extend([
        // Eye sockets, temples.
        blob(v(0.0326, 0.4330, 0.1074), v(0.0163, 0.0105, 0.0315), -7.5),
        blob(v(0.0326, 0.4180, 0.1000), v(0.0150, 0.0055, 0.0300), -2.5),
        blob(v(0.0735, 0.4597, 0.0622), v(0.021, 0.0231, 0.0263), -3.0),
        // Lips, the line between them, the hollows above and below.
        blob(v(0.0, 0.3735, 0.1158), v(0.0150, 0.0046, 0.021), 3.0),
        blob(v(0.0, 0.3580, 0.1147), v(0.0145, 0.0050, 0.021), 3.5),
        blob(v(0.0, 0.3660, 0.1158), v(0.0200, 0.0034, 0.021), -4.5),
        blob(v(0.0, 0.3470, 0.1115), v(0.0180, 0.0055, 0.021), -2.5),
        blob(v(0.0, 0.3841, 0.1158), v(0.0042, 0.0063, 0.021), -1.5),
        // Adam's apple, hollow of the nape, shell of the ear.
        blob(v(0.0, 0.295, 0.045), v(0.008, 0.012, 0.02), 2.5),
        blob(v(0.0, 0.345, -0.055), v(0.012, 0.030, 0.03), -3.0),
        blob(v(0.0872, 0.4219, 0.0076), v(0.0105, 0.0147, 0.0074), -4.0),
    ]);
}

fn leg(sdf: &mut BodySdf) {
    let leg = column(
        2.0,
        [0.05, 0.02],
        &[
            [-1.110, 0.097, 0.034, 0.002, -0.068],
            [-1.080, 0.098, 0.034, 0.004, -0.070],
            [-1.030, 0.099, 0.030, 0.008, -0.064],
            [-0.960, 0.101, 0.036, 0.017, -0.068],
            [-0.880, 0.104, 0.049, 0.028, -0.078],
            [-0.810, 0.104, 0.055, 0.036, -0.079],
            [-0.740, 0.103, 0.051, 0.045, -0.064],
            [-0.690, 0.102, 0.053, 0.056, -0.053],
            [-0.630, 0.102, 0.060, 0.066, -0.058],
            [-0.550, 0.101, 0.072, 0.078, -0.069],
            [-0.460, 0.0980, 0.0830, 0.084, -0.080],
            [-0.390, 0.0935, 0.0865, 0.082, -0.088],
            [-0.310, 0.088, 0.084, 0.072, -0.085],
            [-0.240, 0.082, 0.076, 0.060, -0.070],
        ],
    );
    sdf.parts.push(SdfPart::new(leg, 0.035).mirrored());
    sdf.blobs.extend([
        // Outer and inner thigh muscles above the knee, kneecap and the hollows beside it.
        blob(v(0.150, -0.540, 0.030), v(0.03, 0.090, 0.04), 4.0),
        blob(v(0.070, -0.625, 0.040), v(0.02, 0.035, 0.03), 5.0),
        blob(v(0.102, -0.685, 0.056), v(0.020, 0.024, 0.03), 6.0),
        blob(v(0.102, -0.745, 0.045), v(0.013, 0.016, 0.03), 4.0),
        blob(v(0.140, -0.690, 0.035), v(0.012, 0.030, 0.02), -4.0),
        blob(v(0.066, -0.690, 0.035), v(0.012, 0.026, 0.02), -3.0),
        blob(v(0.102, -0.695, -0.055), v(0.018, 0.030, 0.03), -5.0),
        // The calf's two heads, shin, Achilles tendon, ankle bones.
        blob(v(0.072, -0.835, -0.055), v(0.022, 0.060, 0.03), 6.0),
        blob(v(0.134, -0.815, -0.050), v(0.022, 0.055, 0.03), 5.0),
        blob(v(0.085, -0.900, 0.025), v(0.014, 0.110, 0.02), -3.0),
        blob(v(0.122, -1.050, -0.055), v(0.012, 0.045, 0.018), -5.0),
        blob(v(0.076, -1.050, -0.055), v(0.012, 0.045, 0.018), -5.0),
        blob(v(0.134, -1.086, -0.034), v(0.014, 0.014, 0.014), 5.0),
        blob(v(0.064, -1.076, -0.026), v(0.014, 0.014, 0.014), 5.0),
    ]);
}

fn foot(sdf: &mut BodySdf) {
    // Along z: centre x, half-widths inner and outer, centre y, down, up.
    let rows: [[f64; 7]; 8] = [
        [-0.066, 0.094, 0.026, 0.026, -1.128, 0.024, 0.024],
        [-0.050, 0.095, 0.032, 0.032, -1.124, 0.030, 0.036],
        [-0.015, 0.097, 0.032, 0.035, -1.122, 0.031, 0.046],
        [0.020, 0.100, 0.031, 0.038, -1.124, 0.029, 0.036],
        [0.055, 0.104, 0.036, 0.042, -1.130, 0.024, 0.026],
        [0.090, 0.107, 0.044, 0.044, -1.136, 0.018, 0.019],
        [0.115, 0.109, 0.044, 0.044, -1.141, 0.013, 0.013],
        [0.128, 0.109, 0.040, 0.040, -1.143, 0.010, 0.010],
    ];
    let sections: Vec<CrossSection> = rows
        .iter()
        .map(|&[at, x, inner, outer, y, down, up]| CrossSection {
            at,
            centre: [x, y],
            half: [inner, outer, down, up],
        })
        .collect();
    let sole = Primitive::Tube(Tube::new(2, 2.5, [0.018, 0.010], &sections));
    sdf.parts.push(SdfPart::new(sole, 0.03));
    let instep = chain(&[([0.097, -1.075, -0.020], 0.030), ([0.100, -1.112, 0.050], 0.020)]);
    sdf.parts.push(SdfPart::new(instep, 0.03));
    let toes: [([f64; 3], [f64; 3], f64); 5] = [
        ([0.079, -1.140, 0.110], [0.080, -1.142, 0.156], 0.0135),
        ([0.1015, -1.141, 0.118], [0.103, -1.1445, 0.158], 0.0098),
        ([0.1195, -1.142, 0.112], [0.122, -1.1455, 0.148], 0.0092),
        ([0.1355, -1.143, 0.102], [0.139, -1.146, 0.135], 0.0088),
        ([0.1490, -1.144, 0.090], [0.154, -1.1465, 0.118], 0.0084),
    ];
    for (base, tip, radius) in toes {
        sdf.parts.push(SdfPart::new(chain(&[(base, radius), (tip, radius * 0.95)]), 0.008));
    }
    sdf.blobs.extend([
        // Arch of the foot, ball, Achilles tendon.
        blob(v(0.070, -1.148, 0.020), v(0.020, 0.014, 0.032), -7.0),
        blob(v(0.072, -1.145, 0.100), v(0.014, 0.014, 0.018), 3.0),
    ]);
}

fn arm(sdf: &mut BodySdf) {
    // Along x: centre y, half-widths down and up, centre z, back and front.
    let rows: [[f64; 7]; 14] = [
        [0.120, 0.200, 0.046, 0.046, -0.025, 0.056, 0.050],
        [0.160, 0.212, 0.056, 0.034, -0.026, 0.060, 0.054],
        [0.200, 0.216, 0.055, 0.038, -0.027, 0.056, 0.053],
        [0.250, 0.215, 0.051, 0.043, -0.029, 0.050, 0.048],
        [0.310, 0.214, 0.047, 0.043, -0.032, 0.046, 0.045],
        [0.370, 0.214, 0.042, 0.041, -0.036, 0.042, 0.042],
        [0.415, 0.213, 0.037, 0.037, -0.040, 0.039, 0.037],
        [0.445, 0.213, 0.036, 0.036, -0.041, 0.037, 0.038],
        [0.490, 0.214, 0.037, 0.037, -0.042, 0.039, 0.042],
        [0.540, 0.215, 0.034, 0.035, -0.043, 0.038, 0.039],
        [0.600, 0.216, 0.028, 0.028, -0.044, 0.033, 0.032],
        [0.650, 0.216, 0.022, 0.022, -0.045, 0.029, 0.028],
        [0.682, 0.216, 0.020, 0.020, -0.045, 0.029, 0.028],
        [0.705, 0.216, 0.018, 0.018, -0.045, 0.031, 0.031],
    ];
    let sections: Vec<CrossSection> = rows
        .iter()
        .map(|&[at, y, down, up, z, back, front]| CrossSection {
            at,
            centre: [y, z],
            half: [down, up, back, front],
        })
        .collect();
    let arm = Primitive::Tube(Tube::new(0, 2.0, [0.03, 0.01], &sections));
    sdf.parts.push(SdfPart::new(arm, 0.035));
    let deltoid =
        rotated_ellipsoid(v(0.190, 0.220, -0.026), v(0.070, 0.039, 0.056), v(0.0, 0.0, -0.10));
    sdf.parts.push(SdfPart::new(deltoid, 0.03));
    sdf.blobs.extend([
        // Biceps (front), triceps (back), end of the deltoid, elbow point, flexors of the forearm.
        blob(v(0.325, 0.218, 0.010), v(0.045, 0.022, 0.02), 5.0),
        blob(v(0.310, 0.212, -0.080), v(0.050, 0.024, 0.02), 5.0),
        blob(v(0.262, 0.255, -0.030), v(0.016, 0.02, 0.04), -2.5),
        blob(v(0.428, 0.216, -0.080), v(0.014, 0.016, 0.02), 5.0),
        blob(v(0.432, 0.216, -0.004), v(0.020, 0.020, 0.02), -3.0),
        blob(v(0.490, 0.200, -0.005), v(0.040, 0.022, 0.02), 4.0),
        blob(v(0.500, 0.235, -0.070), v(0.045, 0.018, 0.02), 3.0),
        blob(v(0.676, 0.234, -0.068), v(0.010, 0.012, 0.010), 3.0),
    ]);
}

fn hand(sdf: &mut BodySdf) {
    // Along x: centre y, half-widths down and up, centre z, back and front.
    let rows: [[f64; 7]; 5] = [
        [0.690, 0.216, 0.018, 0.018, -0.045, 0.028, 0.028],
        [0.715, 0.216, 0.017, 0.016, -0.045, 0.034, 0.034],
        [0.740, 0.216, 0.016, 0.014, -0.045, 0.040, 0.040],
        [0.765, 0.216, 0.013, 0.013, -0.046, 0.042, 0.042],
        [0.778, 0.216, 0.011, 0.012, -0.046, 0.041, 0.041],
    ];
    let sections: Vec<CrossSection> = rows
        .iter()
        .map(|&[at, y, down, up, z, back, front]| CrossSection {
            at,
            centre: [y, z],
            half: [down, up, back, front],
        })
        .collect();
    let palm = Primitive::Tube(Tube::new(0, 2.5, [0.01, 0.008], &sections));
    sdf.parts.push(SdfPart::new(palm, 0.012));
    // Index, middle, ring and little finger: knuckle, middle joint, end joint, tip.
    let fingers: [[([f64; 3], f64); 4]; 4] = [
        [
            ([0.766, 0.217, -0.014], 0.0108),
            ([0.808, 0.216, -0.004], 0.0095),
            ([0.833, 0.213, 0.001], 0.0085),
            ([0.852, 0.209, 0.004], 0.0074),
        ],
        [
            ([0.770, 0.218, -0.036], 0.0108),
            ([0.815, 0.217, -0.034], 0.0098),
            ([0.844, 0.213, -0.033], 0.0087),
            ([0.864, 0.209, -0.032], 0.0075),
        ],
        [
            ([0.767, 0.217, -0.058], 0.0104),
            ([0.808, 0.216, -0.063], 0.0092),
            ([0.834, 0.212, -0.066], 0.0082),
            ([0.853, 0.208, -0.068], 0.0072),
        ],
        [
            ([0.760, 0.215, -0.078], 0.0096),
            ([0.792, 0.213, -0.090], 0.0082),
            ([0.811, 0.210, -0.096], 0.0074),
            ([0.826, 0.207, -0.101], 0.0066),
        ],
    ];
    for finger in &fingers {
        sdf.parts.push(SdfPart::new(chain(finger), 0.005));
    }
    let thumb = chain(&[
        ([0.706, 0.210, -0.026], 0.0150),
        ([0.736, 0.205, 0.002], 0.0140),
        ([0.764, 0.202, 0.024], 0.0112),
        ([0.790, 0.200, 0.038], 0.0090),
    ]);
    sdf.parts.push(SdfPart::new(thumb, 0.010));
    sdf.blobs.extend([
        // Hollow of the palm, heel of the hand, knuckles.
        blob(v(0.745, 0.200, -0.046), v(0.022, 0.012, 0.014), -4.0),
        blob(v(0.730, 0.202, -0.072), v(0.025, 0.012, 0.012), 3.0),
        blob(v(0.772, 0.230, -0.016), v(0.007, 0.008, 0.007), 2.0),
        blob(v(0.776, 0.230, -0.037), v(0.007, 0.008, 0.007), 2.0),
        blob(v(0.772, 0.230, -0.058), v(0.007, 0.008, 0.007), 2.0),
        blob(v(0.765, 0.228, -0.077), v(0.007, 0.008, 0.007), 1.5),
    ]);
}

/// Target edge length at `p` up to a common factor: finer on face, hands and feet.
pub(super) fn edge_size(p: DVec3) -> f64 {
    let x = p.x.abs();
    let hand = ramp(x, 0.60, 0.73);
    let head = ramp(p.y, 0.27, 0.34);
    let face = head * ramp(p.z, 0.02, 0.085);
    let ear = head * ramp(x, 0.068, 0.080);
    let features = head * ramp(p.z, 0.070, 0.105) * (1.0 - ramp(p.y, 0.44, 0.48));
    let foot = ramp(-p.y, 1.00, 1.10);
    let toes = foot * ramp(p.z, 0.05, 0.11);
    let mut size = 1.0;
    for (amount, fine) in [
        (hand, 0.36),
        (head, 0.72),
        (face, 0.40),
        (ear, 0.42),
        (features, 0.28),
        (foot, 0.66),
        (toes, 0.50),
    ] {
        size = f64::min(size, 1.0 + amount * (fine - 1.0));
    }
    size
}

/// Quintic smooth step from 0 at `low` to 1 at `high`.
pub(super) fn ramp(x: f64, low: f64, high: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}
