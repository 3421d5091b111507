//! Camera calibration from vehicles on the road (MVCalib), and the lane tables made from it.
