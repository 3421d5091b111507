//! All sites as GeoJSON (RFC 7946), for maps.
//!
//! Owns which figures stand with a site's position.

use super::summary::Summary;
use crate::morning::places::Known;
use serde_json::json;
use std::collections::BTreeMap;

/// All sites, each with its figures; one without a position has no geometry.
pub(super) fn geojson(summaries: &[Summary], places: &BTreeMap<String, Known>) -> Vec<u8> {
    let unknown = Known::default();
    let feature = |summary: &Summary| {
        let place = &places.get(&summary.site).unwrap_or(&unknown).place;
        let (mean, [archived, known]) = (summary.mean(), summary.completeness_pct());
        let rounded = |value: f64| (value * 100.0).round() / 100.0;
        json!({
            "type": "Feature",
            "id": summary.site,
            "geometry": place.position().map(|[latitude, longitude]| {
                json!({ "type": "Point", "coordinates": [longitude, latitude] })
            }),
            "properties": {
                "site": summary.site,
                "name": place.name,
                "road": place.road,
                "direction": place.direction,
                "bearing": place.bearing,
                "mean_density_veh_km": mean.value().map(rounded),
                "low90_veh_km": mean.interval().map(|[low, _]| rounded(low)),
                "high90_veh_km": mean.interval().map(|[_, high]| rounded(high)),
                "archived_pct": rounded(archived),
                "known_pct": rounded(known),
            },
        })
    };
    let features: Vec<_> = summaries.iter().map(feature).collect();
    let all = json!({ "type": "FeatureCollection", "features": features });
    format!("{all}\n").into_bytes()
}
