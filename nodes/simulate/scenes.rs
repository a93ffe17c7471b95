//! The scenes of [`photocurrent_scene::closed`] by name, with their parameters.

use photocurrent_core::{Extent, NodeError};
use photocurrent_scene::closed::{
    ClosedScene, basketball, checkerboard, colour_wheel, fan, pellet, running_man, siemens_disk,
    slingshot_egg, texture,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The scenes by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Name {
    /// A ball with seams that spins and bounces.
    Basketball,
    /// A board of squares that slides and turns.
    Checkerboard,
    /// A rotating disk with sectors of different colours.
    ColourWheel,
    /// Rotating blades.
    #[default]
    Fan,
    /// Pellets that fly straight and bounce off the borders.
    Pellet,
    /// A figure that runs, slowly.
    RunningMan,
    /// A rotating disk with spokes.
    SiemensDisk,
    /// A fast pellet hits an egg, which flies apart.
    SlingshotEgg,
    /// A natural texture that slides.
    Texture,
}

/// Parameters of every scene; only the named one's count.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Details {
    /// Of the scene `basketball`.
    pub basketball: basketball::BasketballParams,
    /// Of the scene `checkerboard`.
    pub checkerboard: checkerboard::CheckerboardParams,
    /// Of the scene `colour_wheel`.
    pub colour_wheel: colour_wheel::ColourWheelParams,
    /// Of the scene `fan`.
    pub fan: fan::FanParams,
    /// Of the scene `pellet`.
    pub pellet: pellet::PelletParams,
    /// Of the scene `running_man`.
    pub running_man: running_man::RunningManParams,
    /// Of the scene `siemens_disk`.
    pub siemens_disk: siemens_disk::SiemensDiskParams,
    /// Of the scene `slingshot_egg`.
    pub slingshot_egg: slingshot_egg::SlingshotEggParams,
    /// Of the scene `texture`.
    pub texture: texture::TextureParams,
}

impl Details {
    /// Refuses parameters of another scene than the one that is shown.
    ///
    /// # Errors
    /// When some are set.
    pub fn check(&self, shown: Name) -> Result<(), NodeError> {
        let default = Details::default();
        let differs = [
            (Name::Basketball, "basketball", self.basketball != default.basketball),
            (Name::Checkerboard, "checkerboard", self.checkerboard != default.checkerboard),
            (Name::ColourWheel, "colour_wheel", self.colour_wheel != default.colour_wheel),
            (Name::Fan, "fan", self.fan != default.fan),
            (Name::Pellet, "pellet", self.pellet != default.pellet),
            (Name::RunningMan, "running_man", self.running_man != default.running_man),
            (Name::SiemensDisk, "siemens_disk", self.siemens_disk != default.siemens_disk),
            (Name::SlingshotEgg, "slingshot_egg", self.slingshot_egg != default.slingshot_egg),
            (Name::Texture, "texture", self.texture != default.texture),
        ];
        let Some((_, name, _)) = differs.into_iter().find(|(name, _, set)| *set && *name != shown) else {
            return Ok(());
        };
        let shown = serde_json::to_value(shown).map_err(|error| NodeError::failed(error.to_string()))?;
        Err(NodeError::usage(format!("`{name}` is set, but the scene is {shown}"))
            .hint(format!("write `scene = \"{name}\"`, or leave `{name}` out"))
            .param(name))
    }

    /// Builds the scene of that name for a picture of that size.
    pub fn scene(&self, name: Name, extent: Extent, seed: u64) -> Box<dyn ClosedScene> {
        match name {
            Name::Basketball => Box::new(basketball::Basketball::new(&self.basketball, extent, seed)),
            Name::Checkerboard => Box::new(checkerboard::Checkerboard::new(&self.checkerboard, extent)),
            Name::ColourWheel => Box::new(colour_wheel::ColourWheel::new(&self.colour_wheel, extent)),
            Name::Fan => Box::new(fan::Fan::new(&self.fan, extent, seed)),
            Name::Pellet => Box::new(pellet::Pellets::new(&self.pellet, extent, seed)),
            Name::RunningMan => Box::new(running_man::RunningMan::new(&self.running_man, extent, seed)),
            Name::SiemensDisk => Box::new(siemens_disk::SiemensDisk::new(&self.siemens_disk, extent)),
            Name::SlingshotEgg => {
                Box::new(slingshot_egg::SlingshotEgg::new(&self.slingshot_egg, extent, seed))
            }
            Name::Texture => Box::new(texture::SlidingTexture::new(&self.texture, seed)),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use photocurrent_scene::closed::{BRIGHTEST, DARKEST};

    pub(crate) const EXTENT: Extent = Extent { width: 80, height: 60 };
    pub(crate) const ALL: [Name; 9] = [
        Name::Basketball,
        Name::Checkerboard,
        Name::ColourWheel,
        Name::Fan,
        Name::Pellet,
        Name::RunningMan,
        Name::SiemensDisk,
        Name::SlingshotEgg,
        Name::Texture,
    ];

    /// Instants over the first 100 ms that hit no special one.
    fn instants() -> impl Iterator<Item = i64> {
        (0..12).map(|k| k * 8_431_007)
    }

    fn pixels() -> impl Iterator<Item = (f64, f64)> {
        EXTENT.rows().iter().flat_map(|y| (0..EXTENT.width).map(move |x| (f64::from(x), f64::from(y))))
    }

    #[test]
    fn reflectance_stays_between_black_felt_and_white_paper_and_uses_the_room() {
        for name in ALL {
            let scene = Details::default().scene(name, EXTENT, 7);
            let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
            for t in instants() {
                for (x, y) in pixels() {
                    let value = scene.light(x, y, t);
                    assert!(
                        (DARKEST - 1e-9..=BRIGHTEST + 1e-9).contains(&value),
                        "{name:?} is {value} at ({x}, {y}), {t} ns"
                    );
                    (least, most) = (least.min(value), most.max(value));
                }
            }
            assert!(most > 4.0 * least, "{name:?} goes from {least} to {most} only");
        }
    }

    #[test]
    fn every_scene_moves_and_says_truly_what_stands_still() {
        for name in ALL {
            let scene = Details::default().scene(name, EXTENT, 7);
            let (mut moved, mut skipped) = (0, 0);
            for t in instants() {
                for (x, y) in pixels() {
                    let now = scene.light(x, y, t);
                    let still = scene.still_until(x, y, t);
                    assert!(still >= t, "{name:?}");
                    let until = still.min(t + 20_000_000);
                    // The first and the last instant of the promise and some between.
                    for share in [0.1, 0.5, 0.9, 1.0] {
                        let later = t + ((until - t) as f64 * share) as i64;
                        let then = scene.light(x, y, later);
                        assert!(
                            (then - now).abs() < 1e-9,
                            "{name:?} at ({x}, {y}) goes from {now} at {t} \
                                                            to {then} at {later}, {until} promised"
                        );
                    }
                    skipped += i32::from(until > t);
                    moved += i32::from((scene.light(x, y, t + 4_000_000) - now).abs() > 0.02);
                }
            }
            assert!(moved > 200, "{name:?}: {moved}");
            assert!(
                skipped > 0 || name == Name::Texture || name == Name::Basketball,
                "{name:?} never stands still"
            );
        }
    }

    #[test]
    fn nothing_crosses_a_pixel_faster_than_the_scene_states() {
        // With the mean over a pixel, a step of one pixel changes reflectance by its whole range at most;
        // twice that for slanted edges.
        let range = BRIGHTEST - DARKEST;
        for name in ALL {
            let scene = Details::default().scene(name, EXTENT, 7);
            for t in instants() {
                for (x, y) in pixels() {
                    let speed = scene.speed(x, y);
                    let step = 2_000;
                    let change = (scene.light(x, y, t + step) - scene.light(x, y, t)).abs();
                    assert!(
                        change <= 2.0 * range * speed * step as f64 + 1e-9,
                        "{name:?} at ({x}, {y}), {t} ns: {change} at {speed} px/ns"
                    );
                }
            }
        }
    }

    #[test]
    fn a_scene_is_its_seed() {
        for name in ALL {
            let picture = |seed| -> Vec<u64> {
                let scene = Details::default().scene(name, EXTENT, seed);
                pixels().map(|(x, y)| scene.light(x, y, 31_000_000).to_bits()).collect()
            };
            assert_eq!(picture(7), picture(7), "{name:?}");
            // What is drawn by geometry alone has no seed.
            let drawn = [Name::Checkerboard, Name::ColourWheel, Name::SiemensDisk].contains(&name);
            assert_eq!(picture(7) == picture(8), drawn, "{name:?}");
        }
    }
}
