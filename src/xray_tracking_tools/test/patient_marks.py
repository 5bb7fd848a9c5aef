"""Makes DICOM files those of somebody: what names the patient, the clinic and their files is put into every attribute that
may have it, and found again wherever it does not belong."""

import os

import pydicom

MARK = 'ZQXMARK'
BIRTH_DATE = '19010203'
# Of DICOM's own names, those that say who and where; and free texts, into which people write it.
TEXTS = """AccessionNumber AdditionalPatientHistory AdmissionID Allergies BranchOfService CountryOfResidence
CurrentPatientLocation DeviceSerialNumber EthnicGroup ImageComments InstitutionAddress
InstitutionName InstitutionalDepartmentName IssuerOfPatientID ManufacturerModelName MedicalAlerts MedicalRecordLocator
MilitaryRank NameOfPhysiciansReadingStudy Occupation OperatorsName OtherPatientIDs OtherPatientNames PatientAddress
PatientBirthName PatientComments PatientID PatientMotherBirthName PatientName PatientReligiousPreference PatientState
PatientTelephoneNumbers PerformedProcedureStepDescription PerformedProcedureStepID PerformedStationAETitle
PerformedStationName PerformingPhysicianName PhysiciansOfRecord ProtocolName RTImageDescription RTImageLabel RTImageName
RTPlanDescription RTPlanLabel RTPlanName ReferringPhysicianAddress ReferringPhysicianName ReferringPhysicianTelephoneNumbers
RegionOfResidence RequestedProcedureDescription RequestingPhysician RequestingService ReviewerName
ScheduledPerformingPhysicianName SeriesDescription StationName StructureSetDescription StructureSetLabel StructureSetName
StudyDescription StudyID""".split()
SHORT = {'AE', 'CS', 'SH'}  # at most 16 characters
PRIVATE = (0x0099, 0x0010)


def dicom_files(folder):
    for parent, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(parent, name)
            if pydicom.misc.is_dicom(path):
                yield path


def uids(data):
    """Those of the data set's own making."""
    for element in data.iterall():
        if element.VR == 'UI' and element.value and not str(element.value).startswith('1.2.840.10008.'):
            yield str(element.value)


def mark(folder):
    """Puts marks into all DICOM files below the folder. @return what must be found nowhere else [bytes]"""
    found = {MARK, BIRTH_DATE}
    for path in dicom_files(folder):
        data = pydicom.dcmread(path)
        for keyword in TEXTS:
            vr = pydicom.datadict.dictionary_VR(keyword)
            if vr not in ('SQ', 'OB'):
                text = f'{MARK}{pydicom.datadict.tag_for_keyword(keyword):08X}'
                setattr(data, keyword, text if vr in SHORT else text + '^of somewhere')
        data.PatientBirthDate = BIRTH_DATE
        data.add_new(PRIVATE, 'LO', MARK + ' creator')
        data.add_new((PRIVATE[0], 0x1001), 'UT', MARK + ' private')
        found.update(uids(data))
        data.save_as(path, write_like_original=False)
    return {text.encode() for text in found}


def name_by_uid(folder):
    """As PACSs name their files."""
    for path in list(dicom_files(folder)):
        os.rename(path, os.path.join(folder, f'CT.{pydicom.dcmread(path).SOPInstanceUID}.dcm'))


def marks_in(folder, marks, inputs):
    """(file, mark) of all files below the folder, but for the given ones, that have a mark in them or in their name."""
    for parent, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(parent, name)
            if path in inputs or os.path.islink(path):
                continue
            with open(path, 'rb') as file:
                content = name.encode() + b'\n' + file.read()
            yield from ((path, each) for each in marks if each in content)
