//! Bodies about curves: sweeps, chains and braids.

use super::round::superellipse;
use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::parts::{Dice, at, spline};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::f64::consts::{PI, TAU};

choice! {
    /// The section of a sweep.
    Section {
        /// A circle.
        Round,
        /// A rounded square.
        Square,
        /// A flat band.
        Ribbon,
        /// A star with round points.
        Star,
        /// A drop, round on one side.
        Drop,
        /// A three-cornered one with round corners.
        Trefoil,
    }
}

impl Section {
    fn at(self, a: f64) -> DVec2 {
        let polar = |r: f64| r * DVec2::new(a.cos(), a.sin());
        match self {
            Self::Round => polar(1.0),
            Self::Square => 0.85 * superellipse(a, 0.3),
            Self::Ribbon => superellipse(a, 0.6) * DVec2::new(1.3, 0.22),
            Self::Star => polar(1.0 + 0.3 * (5.0 * a).cos()),
            Self::Drop => DVec2::new(a.cos(), 0.75 * a.sin() * (0.5 * a).sin().abs().powf(0.8)),
            Self::Trefoil => polar(1.0 + 0.25 * (3.0 * a).cos()),
        }
    }
}

family! {
    /// A section swept along a wandering spline, open like a vine or closed like a loop, of changing width and turning on its
    /// way.
    shape Sweep("organic", Any) |rng| {
        /// The section.
        section: Section = Section::draw(rng);
        /// Points that the spline goes through.
        points: u32 [3, 16] = 4 + rng.below(6);
        /// A loop instead of an open strand.
        closed: bool = rng.chance(0.5);
        /// Half width of the section as a share of the body.
        width: f32 [0.01, 0.15] = rng.log(0.035, 0.1);
        /// How far the width changes along the way.
        swell: f32 [0, 0.8] = rng.between(0.0, 0.6);
        /// Turns of the section along the way.
        twist: f32 [-12, 12] = rng.between(-4.0, 4.0);
        /// How far the path leaves a flat circle or line.
        wander: f32 [0, 1] = rng.between(0.2, 1.0);
        /// Which path.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Sweep {
    fn build(&self) -> (Builder, f64) {
        let mut dice = Dice::new(self.seed);
        let n = self.points as usize;
        let wander = f64::from(self.wander);
        let points: Vec<DVec3> = (0..n)
            .map(|i| {
                let share = i as f64 / if self.closed { n } else { n - 1 } as f64;
                let jump = DVec3::new(dice.between(-0.3, 0.3), dice.between(-0.4, 0.4), dice.between(-0.3, 0.3)) * wander;
                let base = if self.closed {
                    DVec3::new((TAU * share).sin(), 0.0, (TAU * share).cos()) * 0.45
                } else {
                    DVec3::new(0.25 * (TAU * share * 1.3).sin() * wander, share - 0.5, 0.25 * (TAU * share * 1.1).cos() * wander)
                };
                base + jump * if self.closed { 0.8 } else { 1.0 }
            })
            .collect();
        let steps = (220 / n).max(8);
        let path = spline(&points, self.closed, steps);
        let count = path.len() as f64;
        let (width, swell) = (f64::from(self.width), f64::from(self.swell));
        // A closed loop comes back as it left: whole turns.
        let turns = if self.closed { f64::from(self.twist).round() } else { f64::from(self.twist) };
        let phase = dice.between(0.0, TAU);
        let waves = f64::from(1 + dice.below(4) as u32);
        let mut b = Builder::default();
        b.tube(&path, self.closed, 28, [1.0, 8.0], |i, a| {
            let share = i as f64 / if self.closed { count } else { count - 1.0 };
            let taper = if self.closed { 1.0 } else { (1.0 - (2.0 * share - 1.0).abs().powi(6)).max(0.0).powf(0.6) };
            let r = width * (1.0 + swell * (TAU * waves * share + phase).sin()) * taper;
            DVec2::from_angle(TAU * turns * share).rotate(self.section.at(a)) * r
        });
        (b, 45.0)
    }
}

choice! {
    /// How a chain lies.
    Course {
        /// Along a line.
        Straight,
        /// About a circle.
        Ring,
        /// Hanging between two points.
        Hanging,
        /// Winding in waves.
        Wave,
    }
}

family! {
    /// A chain of rounded links, each turned a quarter against the last.
    shape Chain("mechanical", Any) |rng| {
        /// How it lies.
        course: Course = Course::draw(rng);
        /// Links.
        links: u32 [2, 32] = 2 * (2 + rng.below(9));
        /// Radius of the wire as a share of a link's length.
        wire: f32 [0.03, 0.13] = rng.between(0.05, 0.11);
        /// Width of a link as a share of its length.
        width: f32 [0.5, 1] = rng.between(0.55, 0.9);
        /// Depth of the course's waves or sag.
        bend: f32 [0, 1] = rng.between(0.3, 1.0);
        /// Turn of one link against the last beyond a quarter, degrees.
        twist: f32 [-30, 30] = rng.between(-12.0, 12.0);
    }
}

impl Chain {
    fn build(&self) -> (Builder, f64) {
        let (wire, bend) = (f64::from(self.wire), f64::from(self.bend));
        // A ring closes with an even number of links, and none can be smaller than six.
        let ring = self.course == Course::Ring;
        let n = if ring { 2 * self.links.max(6).div_ceil(2) } else { self.links } as usize;
        let half_width = (0.5 * f64::from(self.width)).max(2.4 * wire) - wire;
        // Links touch where the next one's wire lies inside this one's.
        let pitch = 1.0 - 4.0 * wire;
        let span = pitch * n as f64;
        let course = |x: f64| -> DVec3 {
            let share = x / span;
            match self.course {
                Course::Straight => DVec3::new(x, 0.0, 0.0),
                Course::Ring => {
                    let r = span / TAU;
                    DVec3::new(r * (TAU * share).sin(), 0.0, r * (TAU * share).cos())
                }
                Course::Hanging => DVec3::new(x, 0.9 * bend * span * (share - 0.5).powi(2), 0.0),
                Course::Wave => DVec3::new(x, 0.0, 0.35 * bend * pitch * (TAU * x / (6.0 * pitch)).sin()),
            }
        };
        let straight = 0.5 - wire - half_width;
        let link: Vec<DVec3> = (0..36)
            .map(|i| {
                // Two straights and two half circles, walked by angle.
                let a = TAU * f64::from(i) / 36.0;
                let side = if a.cos() >= 0.0 { straight } else { -straight };
                DVec3::new(half_width * a.cos() + side, half_width * a.sin(), 0.0)
            })
            .collect();
        let mut b = Builder::default();
        for i in 0..n {
            let x = (i as f64 + 0.5) * pitch;
            let t = (course(x + 0.3 * pitch) - course(x - 0.3 * pitch)).normalize_or(DVec3::X);
            let spin = PI / 2.0 * (i % 2) as f64 + if ring { 0.0 } else { f64::from(self.twist).to_radians() * i as f64 };
            let turn = DQuat::from_rotation_arc(DVec3::X, t) * DQuat::from_rotation_x(spin + PI / 4.0);
            b.part(at(course(x), turn), |p| p.tube(&link, true, 12, [1.0, 4.0], |_, a| wire * DVec2::new(a.cos(), a.sin())));
        }
        (b, 60.0)
    }
}

choice! {
    /// How strands are interlaced.
    Lace {
        /// A Turk's head: one or more strands plaited about a ring.
        TurksHead,
        /// Three to six strands plaited into a rope.
        Plait,
        /// A woven mat.
        Mat,
        /// Strands twisted about each other.
        Cable,
    }
}

family! {
    /// Interlaced round strands.
    shape Braid("organic", Any) |rng| {
        /// The kind.
        lace: Lace = Lace::draw(rng);
        /// Strands, or strands in each direction of a mat.
        strands: u32 [2, 9] = 2 + rng.below(5);
        /// Crossings along the way.
        crossings: u32 [3, 16] = 4 + rng.below(7);
        /// Radius of a strand as a share of the room it has.
        fill: f32 [0.3, 1] = rng.between(0.55, 0.95);
        /// Height of the weave as a share of the room a strand has.
        relief: f32 [0.5, 1.5] = rng.between(0.8, 1.2);
        /// Flatness of the strands.
        flat: f32 [0.4, 1] = rng.between(0.6, 1.0);
    }
}

impl Braid {
    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let strands = self.strands as usize;
        let (n, m) = (f64::from(self.strands), f64::from(self.crossings));
        let (fill, relief, flat) = (f64::from(self.fill), f64::from(self.relief), f64::from(self.flat));
        let mut strand = |path: &[DVec3], closed: bool, r: f64, sides: usize| {
            b.part(DAffine3::IDENTITY, |p| {
                p.tube(path, closed, sides, [1.0, 12.0], |_, a| r * DVec2::new(a.cos(), flat * a.sin()))
            });
        };
        match self.lace {
            Lace::TurksHead => {
                // (r, z) run about an eight as the angle runs about the ring; strands are shifted copies of one another.
                let r = 0.09 * fill;
                let sides = if strands > 3 { 8 } else { 10 };
                let count = (26_000 / (2 * sides * strands.min(6))).min(420);
                for s in 0..strands.min(6) {
                    let path: Vec<DVec3> = (0..count)
                        .map(|i| {
                            let t = TAU * i as f64 / count as f64;
                            let phase = m * t + TAU * s as f64 / strands.min(6) as f64;
                            let (radius, y) = (1.0 + 0.25 * phase.sin(), 0.12 * relief * (2.0 * phase).cos());
                            DVec3::new(radius * t.sin(), y, radius * t.cos())
                        })
                        .collect();
                    strand(&path, true, r, sides);
                }
            }
            Lace::Plait | Lace::Cable => {
                let count = 140;
                let room = 0.9 / n;
                for s in 0..strands {
                    let path: Vec<DVec3> = (0..=count)
                        .map(|i| {
                            let share = i as f64 / count as f64;
                            let phase = TAU * (share * m / 2.0 + s as f64 / n);
                            let y = (share - 0.5) * 0.45 * m;
                            if self.lace == Lace::Plait {
                                DVec3::new(0.42 * phase.sin(), y, 0.55 * room * relief * (2.0 * phase).sin())
                            } else {
                                let r = 0.32 * (1.0 / (PI / n).sin()).min(3.0) * 0.5;
                                DVec3::new(r * phase.sin(), y, r * phase.cos())
                            }
                        })
                        .collect();
                    strand(&path, false, if self.lace == Lace::Plait { 0.5 * room } else { 0.17 } * fill, 14);
                }
            }
            Lace::Mat => {
                let k = (2 * strands).min(12);
                let pitch = 1.0 / k as f64;
                let r = 0.49 * pitch * fill;
                for s in 0..k {
                    for warp in [false, true] {
                        let path: Vec<DVec3> = (0..=6 * k)
                            .map(|i| {
                                let x = i as f64 / 6.0 * pitch;
                                let across = (s as f64 + 0.5) * pitch;
                                let sign = if (s % 2 == 0) == warp { 1.0 } else { -1.0 };
                                let y = 0.52 * r * flat.max(0.8) * relief * 2.0 * sign * (PI * x / pitch).sin();
                                if warp { DVec3::new(x, y, across) } else { DVec3::new(across, -y, x) }
                            })
                            .collect();
                        strand(&path, false, r, 8);
                    }
                }
            }
        }
        (b, 60.0)
    }
}
