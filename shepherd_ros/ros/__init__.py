"""Plumbing between nodes and rclpy."""
