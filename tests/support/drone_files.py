"""Recordings in the formats of highD and inD, written by hand."""

HIGHD = "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,laneId"
MARKINGS = "8.00;12.00;16.00", "20.00;24.00;28.00"


def write_highd(folder, rows, directions):
    (folder / "01_tracks.csv").write_text("\n".join([HIGHD, *rows]) + "\n")
    about = [f"{name},4.5,1.8,{way}" for name, way in directions.items()]
    (folder / "01_tracksMeta.csv").write_text("\n".join(["id,width,height,drivingDirection", *about]) + "\n")
    (folder / "01_recordingMeta.csv").write_text(
        f"id,frameRate,upperLaneMarkings,lowerLaneMarkings\n1,25,{MARKINGS[0]},{MARKINGS[1]}\n"
    )
    return str(folder / "01_tracks.csv")


def highd_rows(name, x, y, speed, frames, direction=1.0):
    """Return a box of 4.5 m x 1.8 m about (x, y) of the picture, which moves on at a speed."""
    return [
        f"{f},{name},{x + direction * speed * 0.04 * i - 2.25},{y - 0.9},4.5,1.8,{direction * speed},0,0,0,2"
        for i, f in enumerate(frames)
    ]


IND = "recordingId,trackId,frame,xCenter,yCenter,heading,width,length,xVelocity,yVelocity"


def write_ind(folder, rows, rate=25):
    (folder / "00_tracks.csv").write_text("\n".join([IND + ",xAcceleration,yAcceleration", *rows]))
    (folder / "00_tracksMeta.csv").write_text("trackId,class\n1,car\n")
    (folder / "00_recordingMeta.csv").write_text(f"recordingId,frameRate\n0,{rate}\n")
    return str(folder / "00_tracks.csv")
