//! Vehicles other than passenger cars: vans, saloon taxis, minibuses.
//!
//! Owns their names and key points. These are laid out from published outer dimensions
//! (README), not measured as the models of cars are. Does not own how far a vehicle may be
//! from them (see `joint::shape`) nor where a vehicle's body is stated (see `labelme`).

use crate::model::{VehicleModel, parse_models};
use std::sync::LazyLock;

/// What kind of body a vehicle has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Body {
    /// A passenger car: one of the models given, or like them.
    #[default]
    Car,
    /// A saloon taxi, after the Toyota Crown Comfort.
    Taxi,
    /// A van, after the Toyota HiAce.
    Van,
    /// A minibus, after the Toyota Coaster.
    Minibus,
}

static MODELS: LazyLock<Vec<VehicleModel>> = LazyLock::new(|| {
    parse_models(include_str!("../data/bodies.json")).expect("the shipped bodies are readable")
});

impl Body {
    /// All of them.
    pub const ALL: [Body; 4] = [Body::Car, Body::Taxi, Body::Van, Body::Minibus];

    /// The name, as in labels.
    pub fn name(self) -> &'static str {
        match self {
            Body::Car => "car",
            Body::Taxi => "taxi",
            Body::Van => "van",
            Body::Minibus => "minibus",
        }
    }

    /// The body of this name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|b| b.name() == name)
    }

    /// The key points of such a vehicle; `None` for cars, which have the models given.
    pub fn model(self) -> Option<&'static VehicleModel> {
        MODELS.iter().find(|m| m.name == self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_body_but_the_car_has_all_key_points() {
        for body in Body::ALL {
            assert_eq!(Body::of_name(body.name()), Some(body));
            let points = body.model().map(|m| m.points.iter().flatten().count());
            assert_eq!(points, (body != Body::Car).then_some(crate::model::KEY_POINT_COUNT));
        }
        assert_eq!(Body::of_name("lorry"), None);
    }
}
