"""Files of rosbag2: MCAP records, readers, writers, recovery."""
