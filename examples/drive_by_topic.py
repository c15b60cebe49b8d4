# SPDX-License-Identifier: Apache-2.0
"""Drive a running hand by topic. Start one first: tactile-hand run paper --interactive."""

import math

import rclpy
from geometry_msgs.msg import PoseStamped

TARGET = (0.0, 0.0436, 0.4118)  # contact centroid, palm frame, m
grasp = [math.inf] * 3  # where it is


def on_pose(message: PoseStamped) -> None:
    """Keep the newest pose of the grasp."""
    point = message.pose.position
    grasp[:] = point.x, point.y, point.z


rclpy.init()
node = rclpy.create_node("driver")
node.create_subscription(PoseStamped, "auxiliary_pose", on_pose, 10)
command = node.create_publisher(PoseStamped, "desired_pose", 10)
while not command.get_subscription_count():  # a message without a subscriber is lost
    rclpy.spin_once(node, timeout_sec=0.1)

pose = PoseStamped()
pose.header.frame_id = "palm"
pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = TARGET
turn = pose.pose.orientation
turn.x = turn.y = turn.z = turn.w = math.nan  # keep the orientation of the grasp
command.publish(pose)
while math.dist(grasp, TARGET) > 1e-4:
    rclpy.spin_once(node)
print("the grasp is at ({:.4f}, {:.4f}, {:.4f}) m".format(*grasp))
rclpy.shutdown()
