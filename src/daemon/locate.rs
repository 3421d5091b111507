//! Locate: the third stage, from a box in the picture to a place in a lane.
//!
//! Owns which point of a box stands for the vehicle, and the lane table's file. Does not
//! count.

use super::disk;
use super::frame::{Detection, PixelBox, Shape};
use super::plain;
use crate::hidden::Seen;
use crate::lane::{Description, LaneTable, LaneTableError, MAX_CELLS, Place};
use crate::scene::{MAX_REFERENCE, Reference};
use crate::units::{ImagePoint, ImageSize, LaneId, MAX_LANES, VehicleClass};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Largest table file that is read, bytes: the largest table, with room for its header.
const MAX_TABLE_BYTES: u64 = (MAX_CELLS * 5 + MAX_REFERENCE + 4096) as u64;
/// A box that ends this close to the picture's lower edge, px, is cut off by it: where the
/// vehicle meets the road is not in the picture.
const EDGE_PX: f32 = 0.5;

/// Point of a box that is looked up in the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Anchor {
    /// Where the vehicle meets the road: the middle of the box's lower edge.
    #[default]
    GroundContact,
    /// The middle of the box, as the paper has it; it lies above the road, so that the
    /// look-up finds a place behind the vehicle. For comparison.
    BoxCentre,
}

impl Anchor {
    /// The point, in pixels of the picture; `None` where it lies outside.
    fn of(self, bounds: &PixelBox, picture: ImageSize) -> Option<ImagePoint> {
        let u = (bounds.x0 + bounds.x1) / 2.0;
        match self {
            Self::GroundContact if bounds.y1 >= f32::from(picture.height) - EDGE_PX => None,
            Self::GroundContact => Some(ImagePoint { u, v: bounds.y1 }),
            Self::BoxCentre => Some(ImagePoint { u, v: (bounds.y0 + bounds.y1) / 2.0 }),
        }
    }
}

/// One vehicle in its lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// Lane and distance.
    pub place: Place,
    /// Kind of vehicle.
    pub class: VehicleClass,
}

/// Why a lane table cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LocateError {
    /// It cannot be read.
    #[error("lane table {}: {}", path.display(), disk::unread(source))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// It is damaged, or none.
    #[error("lane table {}: {source}", path.display())]
    Table {
        /// The file.
        path: PathBuf,
        /// The fault.
        source: LaneTableError,
    },
    /// It belongs to another camera.
    #[error(
        "lane table {} belongs to camera {found:?}, this is camera {expected:?}: give the \
         table of this camera", path.display()
    )]
    Camera {
        /// The file.
        path: PathBuf,
        /// Camera of the table.
        found: String,
        /// Camera of the configuration.
        expected: String,
    },
    /// One of several presets without a reference of its scene.
    #[error(
        "lane table {} has no reference of the scene, so that several presets cannot be told \
         apart: make it with `mvcalib table --reference FRAMES`", path.display()
    )]
    NoReference {
        /// The file.
        path: PathBuf,
    },
    /// Two presets of one pose, whose scenes cannot be told apart.
    #[error(
        "lane table {} shows the same pose of the camera as {}: give each preset a table of its own, \
         and each once", path.display(), other.display()
    )]
    SamePose {
        /// The file.
        path: PathBuf,
        /// The one before.
        other: PathBuf,
    },
    /// The picture has another shape than the table.
    #[error(
        "a picture of {picture} does not fit the lane table of camera {camera:?}, made for \
         {table}: wrong camera, or its stream was changed"
    )]
    Shape {
        /// Camera of the table.
        camera: String,
        /// Size of the picture.
        picture: String,
        /// Size of the table.
        table: ImageSize,
    },
}

/// A lane table ready for look-ups.
#[derive(Debug)]
pub struct Locator {
    path: PathBuf,
    table: LaneTable<Vec<u8>>,
    sha256: [u8; 32],
    anchor: Anchor,
}

impl Locator {
    /// Reads and checks a table. With `camera`, a table of another camera is refused.
    ///
    /// # Errors
    /// [`LocateError`] says what is wrong with the file.
    pub fn load(path: &Path, camera: Option<&str>, anchor: Anchor) -> Result<Self, LocateError> {
        let read = |source| LocateError::Read { path: path.to_owned(), source };
        let bytes = plain::read(path, MAX_TABLE_BYTES).map_err(read)?;
        let sha256 = Sha256::digest(&bytes).into();
        let table = LaneTable::parse(bytes)
            .map_err(|source| LocateError::Table { path: path.to_owned(), source })?;
        let found = table.description().camera_id.as_str();
        if let Some(expected) = camera
            && expected != found
        {
            return Err(LocateError::Camera {
                path: path.to_owned(),
                found: found.to_owned(),
                expected: expected.to_owned(),
            });
        }
        Ok(Self { path: path.to_owned(), table, sha256, anchor })
    }

    /// SHA-256 of the file.
    pub fn sha256(&self) -> [u8; 32] {
        self.sha256
    }

    /// By how much the road of a pixel is longer along a lane than across it, between two places.
    pub fn foreshortening(&self, lane: LaneId, places_m: [f32; 2]) -> Option<f32> {
        self.table.foreshortening(lane, places_m)
    }

    /// The reference of the static scene, where the table has one.
    ///
    /// # Errors
    /// [`LocateError::Table`] for a wrong one, [`LocateError::NoReference`] where there is
    /// none and one is `needed`.
    pub fn scene(&self, needed: bool) -> Result<Option<Reference>, LocateError> {
        let path = || self.path.clone();
        let scene = self.table.scene();
        let scene = scene.map_err(|source| LocateError::Table { path: path(), source })?;
        if needed && scene.is_none() {
            return Err(LocateError::NoReference { path: path() });
        }
        Ok(scene)
    }

    /// The file that it was read from.
    pub fn file(&self) -> &Path {
        &self.path
    }

    /// The table's metadata.
    pub fn description(&self) -> &Description {
        self.table.description()
    }

    /// One standard error of the length of each lane by its number, as a part.
    pub fn length_rel_errs(&self) -> [Option<f32>; MAX_LANES] {
        let mut errors = [None; MAX_LANES];
        for lane in &self.description().lanes {
            errors[usize::from(lane.id.get()) - 1] = self.table.lane_rel_err(lane.id);
        }
        errors
    }

    /// Checks that a picture of this size belongs to the table. A picture of another size
    /// and the same shape does: the camera's stream, scaled.
    ///
    /// # Errors
    /// [`LocateError::Shape`].
    pub fn check_size(&self, width: usize, height: usize) -> Result<ImageSize, LocateError> {
        let table = self.description().image_size;
        let shape = Shape { width: table.width.into(), height: table.height.into() };
        let size = u16::try_from(width).ok().zip(u16::try_from(height).ok());
        match size {
            Some((width, height)) if shape.admits(width.into(), height.into()) => {
                Ok(ImageSize { width, height })
            }
            _ => Err(LocateError::Shape {
                camera: self.description().camera_id.as_str().to_owned(),
                picture: format!("{width}x{height}"),
                table,
            }),
        }
    }

    /// Where a point of the table's picture lies on the road.
    pub fn place(&self, point: ImagePoint) -> Option<Place> {
        self.table.place(point)
    }

    /// Puts the vehicles of a picture into their lanes; those outside are left out. The scene
    /// stands `shift` (px of the picture) to the right of and below its place in the table.
    pub fn locate(
        &self,
        detections: &[Detection],
        picture: ImageSize,
        shift: ImagePoint,
        located: &mut Vec<Located>,
    ) {
        located.clear();
        for detection in detections {
            let contact = self.contact(&detection.bounds, picture);
            if let Some(place) = contact.and_then(|at| self.place_at(at, picture, shift)) {
                located.push(Located { place, class: detection.class });
            }
        }
    }

    /// The vehicles of a picture as [`crate::hidden`] takes them, in the table's pixels; arguments as
    /// for [`Self::locate`].
    pub fn see(
        &self,
        detections: &[Detection],
        picture: ImageSize,
        shift: ImagePoint,
        seen: &mut Vec<Seen>,
    ) {
        seen.clear();
        for Detection { bounds, class, .. } in detections {
            let contact = self.contact(bounds, picture);
            let place = contact.and_then(|at| self.place_at(at, picture, shift));
            let corner = |u, v| self.in_table(ImagePoint { u, v }, picture, shift);
            let (upper, lower) = (corner(bounds.x0, bounds.y0), corner(bounds.x1, bounds.y1));
            let bounds = PixelBox { x0: upper.u, y0: upper.v, x1: lower.u, y1: lower.v };
            seen.push(Seen { bounds, class: *class, place });
        }
    }

    /// The point that stands for the vehicle in a box, px of the picture; `None` where it lies
    /// outside.
    pub fn contact(&self, bounds: &PixelBox, picture: ImageSize) -> Option<ImagePoint> {
        self.anchor.of(bounds, picture)
    }

    /// Where a point of a picture lies on the road. The scene stands `shift` (px of the picture)
    /// to the right of and below its place in the table.
    pub fn place_at(
        &self,
        point: ImagePoint,
        picture: ImageSize,
        shift: ImagePoint,
    ) -> Option<Place> {
        self.table.place(self.in_table(point, picture, shift))
    }

    /// A point of such a picture in the table's pixels.
    fn in_table(&self, point: ImagePoint, picture: ImageSize, shift: ImagePoint) -> ImagePoint {
        let table = self.description().image_size;
        let scale = |table: u16, picture: u16| f32::from(table) / f32::from(picture);
        ImagePoint {
            u: (point.u - shift.u) * scale(table.width, picture.width),
            v: (point.v - shift.v) * scale(table.height, picture.height),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PICTURE: ImageSize = ImageSize { width: 320, height: 240 };

    fn bounds(y1: f32) -> PixelBox {
        PixelBox { x0: 10.0, y0: 20.0, x1: 30.0, y1 }
    }

    #[test]
    fn a_vehicle_stands_where_it_meets_the_road() {
        let contact = Anchor::GroundContact.of(&bounds(60.0), PICTURE);
        assert_eq!(contact, Some(ImagePoint { u: 20.0, v: 60.0 }));
        let centre = Anchor::BoxCentre.of(&bounds(60.0), PICTURE);
        assert_eq!(centre, Some(ImagePoint { u: 20.0, v: 40.0 }));
    }

    #[test]
    fn a_vehicle_cut_off_by_the_picture_has_no_contact_point() {
        assert_eq!(Anchor::GroundContact.of(&bounds(240.0), PICTURE), None);
        assert!(Anchor::GroundContact.of(&bounds(239.0), PICTURE).is_some());
    }
}
