//! Rooms: windows, panels, halls, vaults, caves.

use super::outdoor::under;
use super::{ASPHALT, CONCRETE, GRASS, Place, ROCK, SOIL, clear, degrees, plain, shaded, skyline, sun, tint, which};
use crate::draw::Draw;
use crate::sky::{Beam, Cover, CoverKind, Finish, Furnishing, HorizonKind, Opening, Room, Sky, Sun, Wall};
use rand_pcg::Pcg64;

/// A room before its light has been scaled.
struct Hall {
    size: [f32; 3],
    walls: [f32; 3],
    floor: [f32; 3],
    ceiling: [f32; 3],
    openings: Vec<Opening>,
    beam: Option<Beam>,
    furnishing: Furnishing,
}

impl Hall {
    fn new(rng: &mut Pcg64, low: [f32; 3], high: [f32; 3], walls: [f32; 3], floor: [f32; 3]) -> Self {
        let size = [0, 1, 2].map(|k| rng.between(low[k], high[k]));
        let painted = rng.chance(0.25);
        let paint = Pcg64::hsv(degrees(rng), rng.between(0.1, 0.45), 1.1);
        let walls = shaded(rng, if painted { [0, 1, 2].map(|k| walls[k] * paint[k]) } else { walls });
        let furnishing = Furnishing { seed: which(rng), contrast: rng.between(0.1, 0.5), scale: 1.0, ..Furnishing::default() };
        let ceiling = walls.map(|v| Pcg64::tidy((v * 1.1).min(0.9)));
        Self { size, walls, floor: shaded(rng, floor), ceiling, openings: Vec::new(), beam: None, furnishing }
    }

    /// The room's mean radiance is drawn, and the radiance of the openings (1 so far) and the beam follow.
    fn sky(mut self, rng: &mut Pcg64) -> Sky {
        let [x, y, z] = self.size;
        let faces = 2.0 * (x * y + y * z + z * x);
        let mean = |c: [f32; 3]| (c[0] + c[1] + c[2]) / 3.0;
        let level = mean(self.walls).min(0.9);
        let open: f32 = self.openings.iter().map(|o| o.size[0] * o.size[1] * if o.glass.is_some() { 0.4 } else { 1.0 }).sum();
        // A window of radiance L sends pi L times its area; what enters bounces 1 / (1 - rho) times.
        let light = (rng.log(0.2, 1.2) * (1.0 - level) * faces / open.max(0.1)).clamp(0.5, 400.0);
        for opening in &mut self.openings {
            opening.radiance = opening.radiance.map(|v| Pcg64::tidy((v * light).min(1e4)));
            opening.lower = opening.lower.map(|lower| lower.map(|v| Pcg64::tidy((v * light).min(1e4))));
        }
        if let Some(beam) = &mut self.beam {
            // The sun's disc may be seen from the middle of the room: it shall not drown all else.
            let most = beam.irradiance[0] * light;
            let scale = light * (24.0 / most).min(1.0);
            beam.irradiance = beam.irradiance.map(|v| Pcg64::tidy(v * scale));
        }
        let eye_height = Pcg64::tidy(rng.between(0.25, 0.5) * y.min(4.0));
        let Self { size, walls, floor, ceiling, openings, beam, furnishing } = self;
        Sky::Room(Room { size, eye_height, walls, floor, ceiling, openings, beam, furnishing: Some(furnishing) })
    }

    /// An opening of the given size about a place of a face, both as shares of what fits.
    fn open(&mut self, wall: Wall, place: [f32; 2], size: [f32; 2], radiance: [f32; 3]) -> &mut Opening {
        let face = wall.face(self.size);
        let size = [0, 1].map(|k| Pcg64::tidy(size[k].clamp(0.05, 0.94 * face[k])));
        let offset = [0, 1].map(|k| Pcg64::tidy(place[k].clamp(-1.0, 1.0) * 0.49 * (face[k] - size[k])));
        self.openings.push(Opening { wall, offset, size, radiance, lower: None, panes: [1; 2], arch: false, glass: None });
        let last = self.openings.len() - 1;
        &mut self.openings[last]
    }

    /// `across x along` panels of the given size on the ceiling.
    fn panels(&mut self, rng: &mut Pcg64, across: u32, along: u32, size: [f32; 2], color: [f32; 3]) {
        let dead = rng.between(0.0, 0.25);
        for i in 0..across {
            for j in 0..along {
                if (i > 0 || j > 0) && rng.chance(f64::from(dead)) {
                    continue;
                }
                let place = |k: u32, n: u32| if n > 1 { 2.0 * k as f32 / (n - 1) as f32 - 1.0 } else { 0.0 };
                let flicker = rng.between(0.85, 1.1);
                let at = [0.9 * place(i, across), 0.92 * place(j, along)];
                self.open(Wall::Ceiling, at, size, color.map(|v| Pcg64::tidy(v * flicker)));
            }
        }
    }
}

const WALLS: [Wall; 4] = [Wall::North, Wall::East, Wall::South, Wall::West];

/// Azimuth a wall faces.
fn outward(wall: Wall) -> f32 {
    match wall {
        Wall::North | Wall::Ceiling => 0.0,
        Wall::East => 90.0,
        Wall::South => 180.0,
        Wall::West => 270.0,
    }
}

/// Daylight through a window: bluish above, darker and warmer below.
fn daylight(rng: &mut Pcg64) -> ([f32; 3], [f32; 3]) {
    let sky = tint(rng, 1.0, 0.2);
    let ground = rng.log(0.1, 0.6);
    (sky, tint(rng, ground, 0.3))
}

fn windows(rng: &mut Pcg64, hall: &mut Hall, wall: Wall, count: u32, share: [f32; 2]) {
    let (sky, lower) = daylight(rng);
    let face = wall.face(hall.size);
    let size = [face[0] / count as f32 * rng.between(0.45, 0.8), face[1] * rng.between(share[0], share[1])];
    let panes = [1 + rng.below(3), 1 + rng.below(3)];
    let height = rng.between(-0.1, 0.5);
    for k in 0..count {
        let place = if count > 1 { 2.0 * k as f32 / (count - 1) as f32 - 1.0 } else { rng.between(-0.5, 0.5) };
        let opening = hall.open(wall, [0.92 * place, height], size, sky);
        opening.lower = Some(lower);
        opening.panes = panes;
    }
}

pub(super) fn window_room(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [3.0, 2.4, 3.0], [9.0, 3.6, 9.0], [0.62, 0.6, 0.56], [0.3, 0.22, 0.15]);
    let first = rng.below(4) as usize;
    let count = 1 + rng.below(3);
    windows(rng, &mut hall, WALLS[first], count, [0.4, 0.65]);
    if rng.chance(0.5) {
        windows(rng, &mut hall, WALLS[(first + 1) % 4], 1, [0.35, 0.6]);
    }
    hall.furnishing.boxes = 2 + rng.below(8);
    hall.sky(rng)
}

/// Sunlight falls into the room and draws the windows on its faces.
pub(super) fn sunlit_room(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [3.5, 2.5, 3.5], [9.0, 4.0, 9.0], [0.62, 0.59, 0.53], [0.32, 0.23, 0.15]);
    let wall = WALLS[rng.below(4) as usize];
    let count = 1 + rng.below(3);
    windows(rng, &mut hall, wall, count, [0.5, 0.8]);
    let strength = rng.log(2.0, 25.0);
    hall.beam = Some(Beam {
        elevation: rng.between(8.0, 45.0),
        azimuth: Pcg64::tidy(outward(wall) + rng.between(-50.0, 50.0)),
        irradiance: [1.0, rng.between(0.75, 0.97), rng.between(0.5, 0.9)].map(|v| Pcg64::tidy(v * strength)),
    });
    hall.furnishing.boxes = rng.below(8);
    hall.furnishing.finish = if rng.chance(0.5) { Finish::Planks } else { Finish::Plain };
    hall.furnishing.scale = rng.between(0.12, 0.3);
    hall.sky(rng)
}

pub(super) fn skylight_hall(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [9.0, 4.5, 9.0], [22.0, 9.0, 26.0], [0.55, 0.54, 0.52], CONCRETE);
    let (sky, _) = daylight(rng);
    let (across, along) = (1 + rng.below(2), 1 + rng.below(4));
    let size = [0, 2].map(|k| hall.size[k] * rng.between(0.3, 0.6) / if k == 0 { across as f32 } else { along as f32 });
    hall.panels(rng, across, along, size, sky);
    let panes = [1 + rng.below(5), 1 + rng.below(5)];
    hall.openings.iter_mut().for_each(|opening| opening.panes = panes);
    if rng.chance(0.5) {
        let strength = rng.log(2.0, 15.0);
        hall.beam = Some(Beam {
            elevation: rng.between(35.0, 80.0),
            azimuth: degrees(rng),
            irradiance: [1.0, rng.between(0.85, 1.0), rng.between(0.7, 0.95)].map(|v| Pcg64::tidy(v * strength)),
        });
    }
    hall.furnishing.pillars = 2 * rng.below(6);
    hall.furnishing.finish = Finish::Tiles;
    hall.furnishing.scale = rng.between(0.8, 2.0);
    hall.sky(rng)
}

fn lamp_white(rng: &mut Pcg64) -> [f32; 3] {
    let warmth = rng.between(-0.35, 0.6);
    [1.0 + 0.2 * warmth.min(0.0), 1.0 - 0.15 * warmth.abs(), 1.0 - 0.6 * warmth.max(0.0)].map(Pcg64::tidy)
}

pub(super) fn corridor_panels(rng: &mut Pcg64) -> Sky {
    let turn = rng.chance(0.5);
    let (low, high) = ([1.8, 2.3, 14.0], [3.5, 3.2, 40.0]);
    let swap = |v: [f32; 3]| if turn { [v[2], v[1], v[0]] } else { v };
    let mut hall = Hall::new(rng, swap(low), swap(high), [0.6, 0.6, 0.58], [0.25, 0.25, 0.26]);
    let color = lamp_white(rng);
    let along = 4 + rng.below(9);
    let (wide, long) = (rng.between(0.3, 0.9), rng.between(0.5, 1.5));
    if turn {
        hall.panels(rng, along, 1, [long, wide], color);
    } else {
        hall.panels(rng, 1, along, [wide, long], color);
    }
    hall.furnishing.finish = if rng.chance(0.5) { Finish::Ribs } else { Finish::Tiles };
    hall.furnishing.scale = rng.between(0.6, 2.5);
    hall.sky(rng)
}

pub(super) fn office_ceiling(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [7.0, 2.5, 7.0], [16.0, 3.4, 18.0], [0.6, 0.6, 0.58], [0.22, 0.22, 0.24]);
    let (across, along, color) = (2 + rng.below(4), 3 + rng.below(5), lamp_white(rng));
    let side = rng.between(0.5, 1.1);
    // Panels are square or long.
    let long = if rng.chance(0.5) { side } else { 1.2 };
    hall.panels(rng, across, along, [side, long], color);
    if rng.chance(0.5) {
        let wall = WALLS[rng.below(4) as usize];
        windows(rng, &mut hall, wall, 3, [0.4, 0.6]);
    }
    hall.furnishing.boxes = 5 + rng.below(11);
    hall.furnishing.finish = Finish::Tiles;
    hall.furnishing.scale = rng.between(0.5, 1.0);
    hall.sky(rng)
}

pub(super) fn warehouse(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [14.0, 5.0, 18.0], [30.0, 10.0, 45.0], [0.32, 0.31, 0.3], CONCRETE);
    if rng.chance(0.6) {
        let (color, along) = (lamp_white(rng), 4 + rng.below(5));
        hall.panels(rng, 3, along, [0.9, 1.6], color);
    }
    if hall.openings.is_empty() || rng.chance(0.5) {
        let (sky, lower) = daylight(rng);
        let wall = WALLS[rng.below(4) as usize];
        // A gate, and a band of glass below the roof.
        let gate = [rng.between(3.0, 6.0), hall.size[1] * rng.between(0.5, 0.8)];
        hall.open(wall, [rng.between(-0.8, 0.8), -1.0], gate, sky).lower = Some(lower);
        let band = hall.open(Wall::East, [0.0, 0.95], [0.9 * hall.size[2], 0.9], sky);
        band.panes = [12, 1];
    }
    hall.furnishing.pillars = 4 + 2 * rng.below(5);
    hall.furnishing.boxes = 4 + rng.below(13);
    hall.furnishing.finish = if rng.chance(0.5) { Finish::Bricks } else { Finish::Ribs };
    hall.furnishing.scale = rng.between(0.6, 2.0);
    hall.sky(rng)
}

pub(super) fn church_windows(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [9.0, 8.0, 18.0], [15.0, 16.0, 36.0], [0.42, 0.38, 0.32], [0.25, 0.22, 0.2]);
    let (bays, tall) = (3 + rng.below(4), hall.size[1] * rng.between(0.4, 0.6));
    let wide = (hall.size[2] / bays as f32 * 0.4).min(0.45 * tall);
    let panes = [2 + rng.below(3), 4 + rng.below(6)];
    let coloured = rng.chance(0.85);
    for wall in [Wall::East, Wall::West] {
        for k in 0..bays {
            let place = 2.0 * k as f32 / (bays - 1) as f32 - 1.0;
            let window = hall.open(wall, [0.85 * place, 0.4], [wide, tall], [1.0; 3]);
            window.panes = panes;
            window.arch = true;
            window.glass = coloured.then(|| which(rng));
        }
    }
    let rose = hall.open(Wall::North, [0.0, 0.6], [0.5 * tall + 1.0, 0.5 * tall + 1.0], [1.0; 3]);
    rose.panes = [6, 6];
    rose.glass = Some(which(rng));
    let strength = rng.log(1.0, 20.0);
    hall.beam = rng.chance(0.7).then(|| Beam {
        elevation: rng.between(15.0, 50.0),
        azimuth: Pcg64::tidy(if rng.chance(0.5) { 90.0 } else { 270.0 } + rng.between(-40.0, 40.0)),
        irradiance: [1.0, 0.9, 0.75].map(|v| Pcg64::tidy(v * strength)),
    });
    hall.furnishing.pillars = 6 + 2 * rng.below(4);
    hall.furnishing.finish = Finish::Bricks;
    hall.furnishing.scale = rng.between(0.8, 1.8);
    hall.sky(rng)
}

/// A tunnel of strip lights, as cars are shown in.
pub(super) fn showroom_tunnel(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [5.0, 3.0, 10.0], [9.0, 4.5, 24.0], [0.35, 0.35, 0.36], [0.2, 0.2, 0.21]);
    let (count, color, thin) = (4 + rng.below(9), lamp_white(rng), rng.between(0.08, 0.3));
    let walls_too = rng.chance(0.7);
    for k in 0..count {
        let place = 2.0 * k as f32 / (count - 1) as f32 - 1.0;
        let wide = 0.9 * hall.size[0];
        hall.open(Wall::Ceiling, [0.0, 0.97 * place], [wide, thin], color);
        if walls_too {
            let tall = 0.85 * hall.size[1];
            hall.open(Wall::East, [0.97 * place, 0.0], [thin, tall], color);
            hall.open(Wall::West, [-0.97 * place, 0.0], [thin, tall], color);
        }
    }
    hall.furnishing.finish = Finish::Plain;
    hall.sky(rng)
}

pub(super) fn attic(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [4.0, 2.0, 5.0], [8.0, 3.0, 12.0], [0.4, 0.29, 0.18], [0.35, 0.24, 0.15]);
    let (sky, _) = daylight(rng);
    for _ in 0..1 + rng.below(3) {
        let (place, size) = ([rng.between(-0.9, 0.9), rng.between(-0.9, 0.9)], [rng.between(0.6, 1.2), rng.between(0.8, 1.4)]);
        hall.open(Wall::Ceiling, place, size, sky).panes = [1, 2];
    }
    let (wall, size) = (WALLS[2 * rng.below(2) as usize], rng.between(0.6, 1.2));
    hall.open(wall, [0.0, 0.3], [size, size], sky).arch = rng.chance(0.5);
    let strength = rng.log(3.0, 30.0);
    hall.beam = rng.chance(0.7).then(|| Beam {
        elevation: rng.between(30.0, 75.0),
        azimuth: degrees(rng),
        irradiance: [1.0, 0.92, 0.78].map(|v| Pcg64::tidy(v * strength)),
    });
    hall.furnishing.boxes = 4 + rng.below(10);
    hall.furnishing.finish = Finish::Planks;
    hall.furnishing.scale = rng.between(0.1, 0.3);
    hall.sky(rng)
}

/// Evening: small lamps on walls and ceiling, black windows.
pub(super) fn lamp_room(rng: &mut Pcg64) -> Sky {
    let mut hall = Hall::new(rng, [3.0, 2.4, 3.0], [8.0, 3.2, 8.0], [0.5, 0.42, 0.34], [0.28, 0.18, 0.11]);
    for _ in 0..1 + rng.below(5) {
        let wall = [Wall::North, Wall::East, Wall::South, Wall::West, Wall::Ceiling][rng.below(5) as usize];
        let side = rng.between(0.15, 0.5);
        let strength = rng.log(0.3, 3.0);
        let warm = [1.0, rng.between(0.6, 0.85), rng.between(0.25, 0.65)].map(|v| Pcg64::tidy(v * strength));
        let place = [rng.between(-0.9, 0.9), if wall == Wall::Ceiling { rng.between(-0.9, 0.9) } else { rng.between(-0.2, 0.7) }];
        hall.open(wall, place, [side, side * rng.between(0.7, 1.6)], warm);
    }
    hall.furnishing.boxes = 3 + rng.below(9);
    hall.sky(rng)
}

pub(super) fn greenhouse(rng: &mut Pcg64) -> Sky {
    let sun = Sun { gain: rng.log(0.7, 3.0), ..sun(rng, 8.0, 75.0) };
    let air = clear(rng, sun, 6.0);
    let roof = Cover {
        kind: CoverKind::Ribs,
        amount: rng.between(0.1, 0.4),
        scale: rng.log(0.5, 2.0),
        elevation: 0.0,
        azimuth: degrees(rng),
        color: shaded(rng, [0.55, 0.56, 0.55]),
        seed: which(rng),
    };
    let horizon = skyline(rng, HorizonKind::Trees, [6.0, 25.0], [0.09, 0.16, 0.05], [0.0, 0.2]);
    let color = if rng.chance(0.5) { SOIL } else { GRASS };
    under(Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, color) }.sky(), roof)
}

/// A pavilion with arches.
pub(super) fn arcade(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 4.0, 35.0);
    let air = clear(rng, sun, 5.0);
    let roof = Cover {
        kind: CoverKind::Arcade,
        amount: rng.between(0.4, 0.75),
        scale: rng.log(0.5, 1.8),
        elevation: 0.0,
        azimuth: 0.0,
        color: shaded(rng, [0.55, 0.5, 0.42]),
        seed: which(rng),
    };
    let kind = [HorizonKind::Hills, HorizonKind::Trees, HorizonKind::Roofs][rng.below(3) as usize];
    let horizon = skyline(rng, kind, [2.0, 8.0], GRASS, [0.2, 0.6]);
    let color = if rng.chance(0.5) { CONCRETE } else { ASPHALT };
    under(Place { air, clouds: Vec::new(), horizon: Some(horizon), ground: plain(rng, color) }.sky(), roof)
}

pub(super) fn cave_mouth(rng: &mut Pcg64) -> Sky {
    let sun = sun(rng, 5.0, 60.0);
    let mut air = clear(rng, sun, 4.0);
    let azimuth = degrees(rng);
    if let crate::sky::Air::Clear { sun, luminance, .. } = &mut air {
        // The sun stands before the opening in some, behind the rock in others.
        if rng.chance(0.5) {
            sun.azimuth = Pcg64::tidy(azimuth + rng.between(-30.0, 30.0));
            sun.elevation = rng.between(5.0, 35.0);
        }
        *luminance = rng.log(0.4, 1.0);
        sun.gain = rng.log(0.5, 2.0);
    }
    let rock = Cover {
        kind: CoverKind::Cave,
        amount: rng.between(0.72, 0.93),
        scale: rng.log(0.6, 2.0),
        elevation: rng.between(10.0, 55.0),
        azimuth,
        color: shaded(rng, ROCK),
        seed: which(rng),
    };
    let horizon = rng.chance(0.6).then(|| skyline(rng, HorizonKind::Hills, [3.0, 12.0], GRASS, [0.3, 0.8]));
    under(Place { air, clouds: Vec::new(), horizon, ground: plain(rng, ROCK) }.sky(), rock)
}
