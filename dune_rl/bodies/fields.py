"""Types of the settings of bodies: their ranges, units and meanings."""

from typing import Annotated

from pydantic import Field

Speed = Annotated[float, Field(gt=0.0, le=50.0, description="top speed [m/s]")]
Push = Annotated[float, Field(gt=0.0, le=500_000.0, description="largest horizontal force on a robot [N]")]
Slope = Annotated[float, Field(gt=0.0, le=90.0, description="steepest ground that it crosses [deg]")]
Depth = Annotated[float, Field(ge=0.0, le=100.0, description="deepest water that it crosses [m]")]
TurnRate = Annotated[float, Field(gt=0.0, le=50.0, description="how fast it turns [rad/s]")]
Acceleration = Annotated[float, Field(gt=0.0, le=20.0, description="largest acceleration [m/s²]")]
Braking = Annotated[float, Field(gt=0.0, le=20.0, description="largest deceleration [m/s²]")]
Length = Annotated[float, Field(gt=0.0, le=30.0, description="length [m]")]
Width = Annotated[float, Field(gt=0.0, le=10.0, description="width [m]")]
Height = Annotated[float, Field(gt=0.0, le=10.0, description="height [m]")]

Wheelbase = Annotated[float, Field(gt=0.0, le=20.0, description="distance of the axles [m]")]
Track = Annotated[float, Field(gt=0.0, le=10.0, description="distance of left and right wheels [m]")]
WheelRadius = Annotated[float, Field(gt=0.0, le=3.0, description="radius of the rear wheels [m]")]
Overhang = Annotated[float, Field(ge=0.0, le=10.0, description="length behind the rear axle [m]")]
TurningCircle = Annotated[
    float, Field(gt=0.0, le=100.0, description="diameter of the tightest turn, kerb to kerb [m]")
]
Clearance = Annotated[float, Field(ge=0.0, le=2.0, description="height of the underside [m]")]
Reverse = Annotated[float, Field(gt=0.0, le=10.0, description="top speed backwards [m/s]")]
Stride = Annotated[float, Field(gt=0.0, le=5.0, description="length of a stride over that of the body")]

Altitude = Annotated[float, Field(gt=0.0, le=100.0, description="height above the ground that it keeps [m]")]
LeastAltitude = Annotated[float, Field(gt=0.0, le=100.0, description="lowest height above the ground [m]")]
MostAltitude = Annotated[float, Field(gt=0.0, le=100.0, description="greatest height above the ground [m]")]
RoomBelow = Annotated[float, Field(ge=0.0, le=10.0, description="room over what it flies over [m]")]
Climb = Annotated[float, Field(gt=0.0, le=20.0, description="largest rate of climb and descent [m/s]")]
