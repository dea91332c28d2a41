#!/usr/bin/env python
# -*- coding: latin-1 -*-
# Mixed tabs and spaces, lines ending as on Windows, an umlaut: Jürgen's.
from __future__ import division
import rospy, numpy
from numpy import array, dot, sqrt, arccos, arctan2, sin, cos, pi
from tf.transformations import *
from kuka_arm.srv import *
from trajectory_msgs.msg import JointTrajectoryPoint
from std_msgs.msg import Float64

previous = None
calls = 0
pub = rospy.Publisher('/ik/error', Float64, queue_size = 10)

def Rz(q): return array([[cos(q), -sin(q), 0], [sin(q), cos(q), 0], [0, 0, 1]])
def Rx(q): return array([[1, 0, 0], [0, cos(q), -sin(q)], [0, sin(q), cos(q)]])

def unwrap(new, old):
    # keeps joints 4 and 6 where they were, turn by turn
    for i in (3, 5):
	while new[i] - old[i] > pi and new[i] - 2*pi > -6.1:
	    new[i] -= 2*pi
	while new[i] - old[i] < -pi and new[i] + 2*pi < 6.1:
            new[i] += 2*pi
    return new

def handle_calculate_IK(req):
    global previous, calls
    calls += 1
    previous = [0]*6 if previous is None else previous
    out = open('log_%d.txt' % calls, 'w')
    result = []
    for pose in req.poses:
        o = [getattr(pose.orientation, c) for c in 'xyzw']
	euler = euler_from_quaternion(o, axes = 'sxyz')
	R = euler_matrix(euler[0], euler[1], euler[2], 'sxyz')[:3, :3]
        ee = array([pose.position.x, pose.position.y, pose.position.z])
        wc = ee - 303/1000*R[:, 0]
        th1 = arctan2(wc[1], wc[0])
        u, v = sqrt(wc[0]**2 + wc[1]**2) - 35/100, wc[2] - 3/4
        A, B, C = sqrt(1.5**2 + 0.054**2), sqrt(u**2 + v**2), 5/4
        th2 = pi/2 - arccos((B**2 + C**2 - A**2)/(2*B*C)) - arctan2(v, u)
        th3 = pi/2 - arccos((A**2 + C**2 - B**2)/(2*A*C)) - arctan2(54, 1500)
        R03 = dot(dot(Rz(th1), Rx(-pi/2)), Rz(th2 - pi/2 + th3))
        R36 = dot(dot(R03.T, R), array([[0, 0, 1], [0, -1, 0], [1, 0, 0]]))
        th5 = arctan2(sqrt(R36[0, 2]**2 + R36[2, 2]**2), R36[1, 2])
        th4 = arctan2(R36[2, 2], -R36[0, 2])
        th6 = arctan2(-R36[1, 1], R36[1, 0])
        previous = unwrap([th1, th2, th3, th4, th5, th6], previous)
        point = JointTrajectoryPoint()
        point.positions = previous
        result.append(point)
        print >>out, "%s" % previous
    out.close()
    pub.publish(Float64(0.0))
    return CalculateIKResponse(result)

def IK_server():
    rospy.init_node('IK_server')
    s = rospy.Service('/calculate_ik', CalculateIK, handle_calculate_IK)
    print "Ready to receive an IK request"
    rospy.spin()

if __name__ == "__main__":
    IK_server()
