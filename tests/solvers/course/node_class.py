#!/usr/bin/env python
# A node as a class, numpy instead of sympy, waiting in a loop of its own.
from __future__ import print_function

import numpy as np
import rospy
from tf.transformations import quaternion_matrix
from trajectory_msgs.msg import JointTrajectoryPoint
from kuka_arm.srv import CalculateIK, CalculateIKResponse


class Kuka(object):
    d1, a1, a2, a3, d4, d7 = .75, .35, 1.25, -.054, 1.5, .303

    def __init__(self):
        self.count = 0
        self.service = rospy.Service('calculate_ik', CalculateIK, self.handle)
        rospy.logwarn('%s is up', rospy.get_name())

    @staticmethod
    def rot(axis, t):
        c, s = np.cos(t), np.sin(t)
        return {'y': np.matrix([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
                'z': np.matrix([[c, -s, 0], [s, c, 0], [0, 0, 1]])}[axis]

    def solve(self, pose):
        o, p = pose.orientation, pose.position
        R = np.matrix(quaternion_matrix([o.x, o.y, o.z, o.w])[:3, :3])
        wc = np.matrix([p.x, p.y, p.z]).T - self.d7 * R[:, 0]
        t1 = np.arctan2(wc[1, 0], wc[0, 0])
        u = np.hypot(wc[0, 0], wc[1, 0]) - self.a1
        v = wc[2, 0] - self.d1
        A, B, C = np.hypot(self.d4, self.a3), np.hypot(u, v), self.a2
        beta = np.arccos((B * B + C * C - A * A) / (2 * B * C))
        gamma = np.arccos((A * A + C * C - B * B) / (2 * A * C))
        t2 = np.pi / 2 - beta - np.arctan2(v, u)
        t3 = np.pi / 2 - gamma - np.arctan2(-self.a3, self.d4)
        M = self.rot('y', t2 + t3).T * self.rot('z', t1).T * R
        t5 = np.arctan2(np.hypot(M[1, 0], M[2, 0]), M[0, 0])
        t4 = np.arctan2(M[1, 0], -M[2, 0])
        t6 = np.arctan2(M[0, 1], M[0, 2])
        return np.array([t1, t2, t3, t4, t5, t6])

    def handle(self, req):
        self.count += 1
        start = rospy.Time.now()
        points = map(lambda pose: JointTrajectoryPoint(positions=self.solve(pose)), req.poses)
        points[0].time_from_start = rospy.Time.now() - start
        print('request', self.count, 'took', points[0].time_from_start.to_sec())
        return points


if __name__ == '__main__':
    rospy.init_node('IK_server', anonymous=True)
    kuka = Kuka()
    rate = rospy.Rate(10)
    while not rospy.is_shutdown():
        rate.sleep()
