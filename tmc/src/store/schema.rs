//! The columns of a density file, and those of the files before.

use arrow_schema::Schema;
use parquet::arrow::parquet_to_arrow_schema;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::SchemaDescriptor;
use std::sync::Arc;

pub(super) const SCHEMA: &str = "message density {
    required int32 window_s; required int64 from (TIMESTAMP(MILLIS,true)); required int32 lane;
    optional int32 cell; optional float position_m; required float length_m;
    optional float density_veh_km; optional float density_se; optional float vehicles_mean;
    optional float space_occupancy; required int32 frames_used; required int32 frames_expected;
    required int32 status; required int64 seq; required boolean clock_synced;
    optional float calibration_rel_err;
    optional float density_low90; optional float density_high90;
    optional float calibration_se; optional float counting_se;
    optional int32 traffic_status; optional int32 vehicles_passed;
    optional float flow_veh_h; optional float flow_low90; optional float flow_high90;
    optional float speed_kmh; optional float speed_low90; optional float speed_high90;
    optional float time_occupancy; optional float queue_m;
}";
/// Columns of the schema, in its order.
pub(super) const COLUMNS: usize = 30;
/// Those of files from before flow and speed were archived.
pub(super) const COLUMNS_WITHOUT_TRAFFIC: usize = 20;
/// Those of files from before the interval of a density was measured.
pub(super) const COLUMNS_WITHOUT_ERRORS: usize = 16;

/// The columns as the query engine knows them.
pub fn arrow_schema() -> Schema {
    let columns = parse_message_type(SCHEMA).expect("the schema is well-formed");
    parquet_to_arrow_schema(&SchemaDescriptor::new(Arc::new(columns)), None)
        .expect("each of its types has one in Arrow")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_counted() {
        assert_eq!(arrow_schema().fields().len(), COLUMNS);
    }
}
