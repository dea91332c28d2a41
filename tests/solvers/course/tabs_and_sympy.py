#!/usr/bin/env python
# Structure of the course's template: everything in one handler, sympy throughout, tabs.
import rospy
import tf
from kuka_arm.srv import *
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from geometry_msgs.msg import Pose
from mpmath import *
from sympy import *


def handle_calculate_IK(req):
	rospy.loginfo("Received %s eef-poses from the plan" % len(req.poses))
	if len(req.poses) < 1:
		print "No valid poses received"
		return -1
	else:
		q1, q2, q3, q4, q5, q6, q7 = symbols('q1:8')
		d1, d2, d3, d4, d5, d6, d7 = symbols('d1:8')
		a0, a1, a2, a3, a4, a5, a6 = symbols('a0:7')
		alpha0, alpha1, alpha2, alpha3, alpha4, alpha5, alpha6 = symbols('alpha0:7')

		s = {alpha0: 0, a0: 0, d1: 0.75, q1: q1,
			 alpha1: -pi/2, a1: 0.35, d2: 0, q2: q2 - pi/2,
			 alpha2: 0, a2: 1.25, d3: 0, q3: q3}

		def TF(alpha, a, d, q):
			return Matrix([[cos(q), -sin(q), 0, a],
						   [sin(q)*cos(alpha), cos(q)*cos(alpha), -sin(alpha), -sin(alpha)*d],
						   [sin(q)*sin(alpha), cos(q)*sin(alpha), cos(alpha), cos(alpha)*d],
						   [0, 0, 0, 1]])

		T0_1 = TF(alpha0, a0, d1, q1).subs(s)
		T1_2 = TF(alpha1, a1, d2, q2).subs(s)
		T2_3 = TF(alpha2, a2, d3, q3).subs(s)
		R0_3 = T0_1[0:3, 0:3] * T1_2[0:3, 0:3] * T2_3[0:3, 0:3]

		r, p, y = symbols('r p y')
		ROT_x = Matrix([[1, 0, 0], [0, cos(r), -sin(r)], [0, sin(r), cos(r)]])
		ROT_y = Matrix([[cos(p), 0, sin(p)], [0, 1, 0], [-sin(p), 0, cos(p)]])
		ROT_z = Matrix([[cos(y), -sin(y), 0], [sin(y), cos(y), 0], [0, 0, 1]])
		ROT_EE = ROT_z * ROT_y * ROT_x
		ROT_error = ROT_z.subs(y, pi) * ROT_y.subs(p, -pi/2)
		ROT_EE = ROT_EE * ROT_error

		joint_trajectory_list = []
		for x in xrange(0, len(req.poses)):
			joint_trajectory_point = JointTrajectoryPoint()
			px = req.poses[x].position.x
			py = req.poses[x].position.y
			pz = req.poses[x].position.z
			(roll, pitch, yaw) = tf.transformations.euler_from_quaternion(
				[req.poses[x].orientation.x, req.poses[x].orientation.y,
				 req.poses[x].orientation.z, req.poses[x].orientation.w])
			R = ROT_EE.evalf(subs={r: roll, p: pitch, y: yaw})
			EE = Matrix([[px], [py], [pz]])
			WC = EE - 0.303 * R[:, 2]
			theta1 = atan2(WC[1], WC[0])
			side_a = sqrt(1.50**2 + 0.054**2)
			reach = sqrt(WC[0]**2 + WC[1]**2) - 0.35
			height = WC[2] - 0.75
			side_b = sqrt(reach**2 + height**2)
			side_c = 1.25
			angle_a = acos((side_b**2 + side_c**2 - side_a**2) / (2*side_b*side_c))
			angle_b = acos((side_a**2 + side_c**2 - side_b**2) / (2*side_a*side_c))
			theta2 = pi/2 - angle_a - atan2(height, reach)
			theta3 = pi/2 - (angle_b + atan2(0.054, 1.50))
			R0_3n = R0_3.evalf(subs={q1: theta1, q2: theta2, q3: theta3})
			R3_6 = R0_3n.transpose() * R
			theta4 = atan2(R3_6[2, 2], -R3_6[0, 2])
			theta5 = atan2(sqrt(R3_6[0, 2]**2 + R3_6[2, 2]**2), R3_6[1, 2])
			theta6 = atan2(-R3_6[1, 1], R3_6[1, 0])
			joint_trajectory_point.positions = [theta1, theta2, theta3, theta4, theta5, theta6]
			joint_trajectory_list.append(joint_trajectory_point)

		rospy.loginfo("length of Joint Trajectory List: %s" % len(joint_trajectory_list))
		return CalculateIKResponse(joint_trajectory_list)


def IK_server():
	rospy.init_node('IK_server')
	s = rospy.Service('calculate_ik', CalculateIK, handle_calculate_IK)
	print "Ready to receive an IK request"
	rospy.spin()


if __name__ == "__main__":
	IK_server()
