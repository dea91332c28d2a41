#!/usr/bin/env python
# Learns from the simulator where the wrist stands, and takes the nearer of two wrist branches.
import math
import angles
import rospy
import tf
from gazebo_msgs.srv import GetJointProperties, GetJointPropertiesRequest
from kuka_arm.srv import *
from trajectory_msgs.msg import JointTrajectoryPoint


def current_joint_angles():
    rospy.wait_for_service('/gazebo/get_joint_properties')
    try:
        proxy = rospy.ServiceProxy('/gazebo/get_joint_properties', GetJointProperties)
        found = []
        for number in range(1, 7):
            answer = proxy('joint_%d' % number)
            if not answer.success:
                raise rospy.ServiceException, answer.status_message
            found.append(answer.position[0])
        return found
    except rospy.ServiceException, error:
        rospy.logerr("no joint angles: %s", error)
        return [0.0] * 6


def near(angle, where, limit):
    "the turn of an angle that is nearest to where a joint stands, within its limit"
    best = where + angles.shortest_angular_distance(where, angle)
    if best > limit:
        best -= 2*math.pi
    elif best < -limit:
        best += 2*math.pi
    return best


def solve(position, quaternion, last):
    R = tf.transformations.quaternion_matrix(quaternion)
    w = [position[i] - 0.303*R[i][0] for i in range(3)]
    t1 = math.atan2(w[1], w[0])
    u, v = math.hypot(w[0], w[1]) - .35, w[2] - .75
    a, b, c = math.hypot(1.5, .054), math.hypot(u, v), 1.25
    t2 = math.pi/2 - math.acos((b*b + c*c - a*a)/(2*b*c)) - math.atan2(v, u)
    t3 = math.pi/2 - math.acos((a*a + c*c - b*b)/(2*a*c)) - math.atan2(.054, 1.5)
    M = tf.transformations.concatenate_matrices(
        tf.transformations.rotation_matrix(-(t2 + t3), (0, 1, 0)),
        tf.transformations.rotation_matrix(-t1, (0, 0, 1)), R)
    limit = math.radians(350)
    options = []
    for sign in (1, -1):
        t5 = math.atan2(sign*math.hypot(M[1][0], M[2][0]), M[0][0])
        t4 = near(math.atan2(sign*M[1][0], -sign*M[2][0]), last[3], limit)
        t6 = near(math.atan2(sign*M[0][1], sign*M[0][2]), last[5], limit)
        options.append((abs(t4 - last[3]) + abs(t5 - last[4]) + abs(t6 - last[5]),
                        [t1, t2, t3, t4, t5, t6]))
    return min(options)[1]


def handle_calculate_IK(req):
    last = current_joint_angles()
    rospy.loginfo("standing at %s", `last`)
    response = CalculateIKResponse()
    for pose in req.poses:
        p, q = pose.position, pose.orientation
        last = solve((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), last)
        point = JointTrajectoryPoint()
        point.positions = tuple(last)
        response.points.append(point)
    return response


rospy.init_node('IK_server')
rospy.Service('calculate_ik', CalculateIK, handle_calculate_IK).spin()
